"""Environment steps per second of training: ours, a plain one-run loop, and the limit of a core.

Every measurement is a separate process, so that settings do not leak. The timed CPU seconds begin
after imports and a warm-up, and include rollout, replay, updates and records; the SAC family takes
a gradient step for every environment step. Each turn goes through all measurements, so that ratios
are of neighbours; ratios and speeds are medians over turns. The limit is the speed of a training
that only computed an epoch's matrix products, at the best speed of a batched product measured on
this core in the same run, and MuJoCo's steps if the task has them.

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

CIRCLE, GOAL, EPISODE = "Circle2D-1-v0", "circle2d_mj/SafetyPointGoal1-v0", 50
TASKS = dict.fromkeys(("trpo-lag", "cpo", "sac-lag", "sac-lb", "wcsac"), CIRCLE) | {"ppo-lag": GOAL}
WARM_UP = {"trpo-lag": 1_000, "cpo": 1_000, "ppo-lag": 10_000}
STEPS = {"trpo-lag": 10_000, "cpo": 10_000, "ppo-lag": 10_000}
"""Steps of a run before the timing, and timed ones; an on-policy epoch has 500 or 10,000."""
OFF_POLICY = (300, 1_000)
PLAIN = [name for name, task in TASKS.items() if task == CIRCLE]


def lengths(algorithm):
    """Return the number of steps before the timing, and of timed ones."""
    return (WARM_UP[algorithm], STEPS[algorithm]) if algorithm in STEPS else OFF_POLICY


def plain(algorithm):
    """Return the speed of one run of the plain loop."""
    import plain_sac
    import plain_trpo
    import torch

    torch.set_num_threads(1)
    warm_up, timed = lengths(algorithm)
    if algorithm in STEPS:
        epochs = plain_trpo.epochs(0, algorithm)
    else:
        epochs = plain_sac.epochs(0, algorithm, random_steps=0, gradient_steps=EPISODE)
    steps = 0
    while steps < warm_up:
        steps, *_ = next(epochs)
    before, start = steps, time.process_time()
    while steps < before + timed:
        steps, *_ = next(epochs)
    return (steps - before) / (time.process_time() - start)


@contextlib.contextmanager
def prepared(algorithm, runs):
    """Yield a trainer of runs as in `circle2d train`, but without random actions at the start."""
    from dataclasses import replace

    from agents.presets import preset
    from agents.training.config import TrainConfig
    from agents.training.trainer import Trainer

    config = preset(algorithm, TASKS[algorithm])
    if algorithm not in STEPS:
        config = replace(config, random_steps=0, gradient_steps=EPISODE)
    seeds, steps = tuple(range(runs)), sum(lengths(algorithm))
    training = TrainConfig(algorithm, (TASKS[algorithm],), seeds, steps, config)
    with tempfile.TemporaryDirectory() as folder:
        training.write(Path(folder))
        with contextlib.closing(Trainer(Path(folder), training)) as trainer:
            yield trainer


def lockstep(algorithm, runs, how):
    """Return the speed of all runs together; how: the backend, "c++" or "numpy"."""
    from agents.lockstep import backend

    backend.configure(how)
    with prepared(algorithm, runs) as trainer:
        while trainer.steps[0] < lengths(algorithm)[0]:
            trainer.run_epoch()
        before, start = trainer.steps.sum(), time.process_time()
        while not trainer.done:
            trainer.run_epoch()
        trainer.save()
        return (trainer.steps.sum() - before) / (time.process_time() - start)


def counted_kernel():
    """Return a NumPy kernel that counts the operations of its matrix products."""
    from agents.lockstep import kernel

    class Counted(kernel.InNumpy):
        operations = 0

        def count(self, net, nets, rows, first):
            """Count a product with each layer's weights; first: whether to include layer one."""
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
    """Return the speed of one run that only computed its matrix products, and MuJoCo's steps.

    Products run at this core's best speed of a batched product: that of the first hidden layer of
    12 runs' critics."""
    import safety_speed
    import torch

    from agents.lockstep import backend, kernel

    backend.configure("numpy")
    with prepared(algorithm, 1) as trainer:
        while trainer.steps[0] < lengths(algorithm)[0]:
            trainer.run_epoch()
        before, counted = trainer.steps[0], counted_kernel()
        kernel.IN_NUMPY, kernel._kernel = counted, counted
        trainer.run_epoch()
        operations = counted.operations / (trainer.steps[0] - before)
    a, b = torch.randn(48, 256, 64), torch.randn(48, 64, 64)
    best = 0.0
    for _ in range(50):
        start = time.process_time()
        for _ in range(10):
            torch.bmm(a, b)
        best = max(best, 10 * 2 * 48 * 256 * 64 * 64 / (time.process_time() - start))
    physics = 0.0
    if TASKS[algorithm] == GOAL:
        alone = safety_speed.mujoco_alone(GOAL)
        physics = 1 / max(alone() for _ in range(6))
    print(
        f"{algorithm}: {operations / 1e6:.2f} MFLOP a step, {best / 1e9:.0f} GFLOP/s, "
        f"{1e6 * physics:.0f} µs of MuJoCo",
        file=sys.stderr,
    )
    return 1 / (operations / best + physics)


def speed(algorithm, runs, how):
    """Measure in a separate process; runs: number in lockstep, 0: the plain loop, -1: the limit."""
    command = [sys.executable, __file__, "--one", algorithm, str(runs), how]
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    return float(done.stdout)


def table(found, algorithms, runs):
    """Return the table as Markdown; found: (algorithm, runs) -> speeds, one per turn."""
    head = ["algorithm", "plain, 1 run"]
    for n in runs:
        head += [f"lockstep, {n} run{'s' if n > 1 else ''}", "over plain", "share of the limit"]
    lines = [[*head, "limit"], ["---"] * (len(head) + 1)]
    for algorithm in algorithms:
        of_plain, limits = found.get((algorithm, 0)), found[algorithm, -1]
        cells = [algorithm, f"{statistics.median(of_plain):,.0f}" if of_plain else ""]
        for n in runs:
            speeds = found[algorithm, n]
            cells += [f"{statistics.median(speeds):,.0f}"]
            cells += [f"{ratio(speeds, of_plain):.2f}" if of_plain else ""]
            cells += [f"{100 * ratio(speeds, limits):.0f} %"]
        lines.append([*cells, f"{statistics.median(limits):,.0f}"])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def ratio(some, others):
    """Return the median ratio over turns."""
    return statistics.median(a / b for a, b in zip(some, others, strict=True))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--algorithms", nargs="+", choices=TASKS, default=list(TASKS))
    parser.add_argument("--runs", nargs="+", type=int, default=[1, 12], help="runs in lockstep")
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--how", choices=["c++", "numpy"], default="c++")
    parser.add_argument("--one", nargs=3, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.one:
        algorithm, runs, how = args.one[0], int(args.one[1]), args.one[2]
        kinds = {0: plain, -1: limit}
        print(kinds[runs](algorithm) if runs in kinds else lockstep(algorithm, runs, how))
        return
    kinds = [(name, n) for name in args.algorithms for n in (0, *args.runs, -1)]
    found = {(name, n): [] for name, n in kinds if n or name in PLAIN}
    for turn in range(args.turns):
        for (algorithm, n), speeds in found.items():
            speeds.append(speed(algorithm, n, args.how))
            names = {0: "plain", -1: "limit"}
            what = f"{algorithm}, {names.get(n, f'{n} in lockstep, {args.how}')}"
            print(f"turn {turn + 1}: {what}: {speeds[-1]:,.0f}", file=sys.stderr)
    print(table(found, args.algorithms, args.runs))


if __name__ == "__main__":
    main()
