"""Environment steps a second of training: runs in lockstep beside the plain one-run loop, one core.

Every measurement has a process of its own, so that none has another's settings. What is timed
begins after imports and a warm-up, and holds rollout, replay, updates and records. Turns
go through all of them, so that a ratio is of neighbours; ratios and speeds are medians over turns.
The limit is what the matrix products of an epoch alone would allow, at the best speed of a batched
product that this core has shown in the same run.

python benchmarks/training_speed.py --algorithms cpo wcsac --runs 3 12 --turns 3
"""

import argparse
import contextlib
import itertools
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

TASK, WARM_UP = "Circle2D-1-v0", 1_000
ON_POLICY = ("trpo-lag", "cpo")
STEPS = {"trpo-lag": 10_000, "cpo": 10_000, "sac-lag": 3_000, "sac-lb": 3_000, "wcsac": 3_000}
"""Timed steps of a run; an on-policy epoch is 500 of them."""

PEERS = {
    "trpo-lag": "omnisafe 1 730-1 914, fast-safe-rl 2 500-4 757",
    "cpo": "omnisafe 1 704-1 718, fast-safe-rl 2 500-4 757",
    "sac-lag": "omnisafe 1 222-1 441, fast-safe-rl 1 009-1 256, the paper's group 1 262-1 425",
    "sac-lb": "the paper's group 965-1 319",
    "wcsac": "the paper's group 882-1 277",
}
"""One run, env steps/s, same task and hyper-parameters: omnisafe 0.5.0, fast-safe-rl 0.1.0, and the
own library of the paper's group on Stable-Baselines3 2.7."""


def plain(algorithm):
    """Speed of one run of the plain loop."""
    import plain_sac
    import plain_trpo

    if algorithm in ON_POLICY:
        epochs = plain_trpo.epochs(0, algorithm, TASK)
    else:
        epochs = plain_sac.epochs(0, algorithm, TASK, random_steps=0)
    steps = 0
    while steps < WARM_UP:
        steps, *_ = next(epochs)
    before, start = steps, time.perf_counter()
    while steps < before + STEPS[algorithm]:
        steps, *_ = next(epochs)
    return (steps - before) / (time.perf_counter() - start)


@contextlib.contextmanager
def prepared(algorithm, runs):
    """Trainer of runs as `circle2d train` trains them, but that none acts at random."""
    from dataclasses import replace

    from agents.presets import preset
    from agents.training.config import TrainConfig
    from agents.training.trainer import Trainer

    config = preset(algorithm, TASK)
    if algorithm not in ON_POLICY:
        config = replace(config, random_steps=0)
    seeds, steps = tuple(range(runs)), WARM_UP + STEPS[algorithm]
    training = TrainConfig(algorithm, (TASK,), seeds, steps, config)
    with tempfile.TemporaryDirectory() as folder:
        training.write(Path(folder))
        with contextlib.closing(Trainer(Path(folder), training)) as trainer:
            yield trainer


def lockstep(algorithm, runs, how):
    """Speed of all runs together; how: the backend, "c++" or "numpy"."""
    from agents.lockstep import backend

    backend.configure(how)
    with prepared(algorithm, runs) as trainer:
        while trainer.steps[0] < WARM_UP:
            trainer.run_epoch()
        before, start = trainer.steps.sum(), time.perf_counter()
        while not trainer.done:
            trainer.run_epoch()
        trainer.save()
        return (trainer.steps.sum() - before) / (time.perf_counter() - start)


def counted_kernel():
    """A kernel in NumPy that counts the operations of its matrix products."""
    from agents.lockstep import kernel

    class Counted(kernel.InNumpy):
        operations = 0

        def count(self, net, nets, rows, first):
            """Of a product with each layer's weights; first: whether with the first layer's."""
            layers = list(itertools.pairwise(net.sizes))[0 if first else 1 :]
            self.operations += 2 * nets * rows * sum(a * b for a, b in layers)

        def forward(self, net, params, x, share=1):
            self.count(net, len(params), x.shape[1], first=True)
            return super().forward(net, params, x, share)

        def backward(self, net, params, x, tape, dy, of, share=1):
            self.count(net, len(params), x.shape[1], first="x" in of)
            if "p" in of:
                self.count(net, len(params), x.shape[1], first=True)
            return super().backward(net, params, x, tape, dy, of, share)

        def curvature(self, it, v, iterations=0):
            for first in () if iterations else (True, False):
                self.count(it.net, len(it.params), it.inputs.shape[1], first)
            return super().curvature(it, v, iterations)

    return Counted()


def limit(algorithm):
    """Speed of one run if it had its matrix products alone to compute, at this core's best speed of
    a batched product: that of the first hidden layer of 12 runs' critics."""
    import torch

    from agents.lockstep import backend, kernel

    backend.configure("numpy")
    with prepared(algorithm, 1) as trainer:
        while trainer.steps[0] < WARM_UP:
            trainer.run_epoch()
        before, counted = trainer.steps[0], counted_kernel()
        kernel.IN_NUMPY, kernel._kernel = counted, counted
        trainer.run_epoch()
        operations = counted.operations / (trainer.steps[0] - before)
    a, b = torch.randn(48, 256, 64), torch.randn(48, 64, 64)
    best = 0.0
    for _ in range(50):
        start = time.perf_counter()
        for _ in range(10):
            torch.bmm(a, b)
        best = max(best, 10 * 2 * 48 * 256 * 64 * 64 / (time.perf_counter() - start))
    print(
        f"{algorithm}: {operations / 1e6:.2f} MFLOP a step, {best / 1e9:.0f} GFLOP/s",
        file=sys.stderr,
    )
    return best / operations


def speed(algorithm, runs, how):
    """One measurement in a process of its own; 0 runs: of the plain loop; -1: the limit."""
    command = [sys.executable, __file__, "--one", algorithm, str(runs), how]
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    return float(done.stdout)


def table(found, algorithms, runs):
    """Markdown; found: (algorithm, runs) -> speeds, one a turn."""
    head = ["algorithm", "plain, 1 run"]
    for n in runs:
        head += [f"lockstep, {n} run{'s' if n > 1 else ''}", "over plain"]
    head += ["limit", "share of it"]
    lines = [[*head, "others, 1 run, another machine"], ["---"] * (len(head) + 1)]
    for algorithm in algorithms:
        of_plain = found[algorithm, 0]
        cells = [algorithm, f"{statistics.median(of_plain):,.0f}"]
        for n in runs:
            speeds = found[algorithm, n]
            ratio = statistics.median(a / b for a, b in zip(speeds, of_plain, strict=True))
            cells += [f"{statistics.median(speeds):,.0f}", f"{ratio:.2f}"]
        of_limit = [
            a / b for a, b in zip(found[algorithm, runs[-1]], found[algorithm, -1], strict=True)
        ]
        cells.append(f"{statistics.median(found[algorithm, -1]):,.0f}")
        cells.append(f"{100 * statistics.median(of_limit):.0f} %")
        lines.append([*cells, PEERS[algorithm]])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--algorithms", nargs="+", choices=STEPS, default=list(STEPS))
    parser.add_argument("--runs", nargs="+", type=int, default=[12], help="numbers in lockstep")
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--how", choices=["c++", "numpy"], default="c++")
    parser.add_argument("--one", nargs=3, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.one:
        algorithm, runs, how = args.one[0], int(args.one[1]), args.one[2]
        kinds = {0: plain, -1: limit}
        print(kinds[runs](algorithm) if runs in kinds else lockstep(algorithm, runs, how))
        return
    found = {(algorithm, n): [] for algorithm in args.algorithms for n in (0, *args.runs, -1)}
    for turn in range(args.turns):
        for (algorithm, n), speeds in found.items():
            speeds.append(speed(algorithm, n, args.how))
            names = {0: "plain", -1: "limit"}
            what = f"{algorithm}, {names.get(n, f'{n} in lockstep, {args.how}')}"
            print(f"turn {turn + 1}: {what}: {speeds[-1]:,.0f}", file=sys.stderr)
    print(f"Environment steps a second of training on {TASK}, all runs together:\n")
    print(table(found, args.algorithms, args.runs))
    print(
        "\nOthers: omnisafe 0.5.0, fast-safe-rl 0.1.0, the own library of the paper's group on\n"
        "Stable-Baselines3 2.7. Measured on another machine: compare with care."
    )


if __name__ == "__main__":
    main()
