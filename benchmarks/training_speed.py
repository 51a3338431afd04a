"""Environment steps a second of training: runs in lockstep beside the plain one-run loop, one core.

Every measurement has a process of its own, so that none has another's settings. What is timed
begins after imports and a warm-up, and holds rollout, replay, updates and records. Turns go through
all of them, so that a ratio is of neighbours; ratios and speeds are medians over turns.

python benchmarks/training_speed.py --algorithms cpo wcsac --runs 3 12 --turns 3
"""

import argparse
import os
import statistics
import subprocess
import sys
import time

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


def lockstep(algorithm, runs):
    """Speed of all runs together, as `circle2d train` trains them."""
    import tempfile
    from dataclasses import replace
    from pathlib import Path

    from agents.bench.presets import preset
    from agents.lockstep import backend
    from agents.runs.config import TrainConfig
    from agents.runs.train import Training

    backend.configure()
    config = preset(algorithm, TASK)
    if algorithm not in ON_POLICY:
        config = replace(config, random_steps=0)
    seeds, steps = tuple(range(runs)), WARM_UP + STEPS[algorithm]
    config = TrainConfig(algorithm, TASK, seeds, steps, config)
    with tempfile.TemporaryDirectory() as folder:
        config.write(Path(folder))
        training = Training(config)
        while training.steps[0] < WARM_UP:
            training.run_epoch()
        before, start = training.steps.sum(), time.perf_counter()
        while not training.done:
            training.run_epoch()
        training.save(Path(folder))
        return (training.steps.sum() - before) / (time.perf_counter() - start)


def speed(algorithm, runs):
    """One measurement in a process of its own; 0 runs: of the plain loop."""
    command = [sys.executable, __file__, "--one", algorithm, str(runs)]
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    return float(done.stdout)


def table(found, algorithms, runs):
    """Markdown; found: (algorithm, runs) -> speeds, one a turn."""
    head = ["algorithm", "plain, 1 run"]
    for n in runs:
        head += [f"lockstep, {n} run{'s' if n > 1 else ''}", "over plain"]
    lines = [[*head, "others, 1 run, another machine"], ["---"] * (len(head) + 1)]
    for algorithm in algorithms:
        of_plain = found[algorithm, 0]
        cells = [algorithm, f"{statistics.median(of_plain):,.0f}"]
        for n in runs:
            speeds = found[algorithm, n]
            ratio = statistics.median(a / b for a, b in zip(speeds, of_plain, strict=True))
            cells += [f"{statistics.median(speeds):,.0f}", f"{ratio:.2f}"]
        lines.append([*cells, PEERS[algorithm]])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--algorithms", nargs="+", choices=STEPS, default=list(STEPS))
    parser.add_argument("--runs", nargs="+", type=int, default=[12], help="numbers in lockstep")
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--one", nargs=2, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.one:
        algorithm, runs = args.one[0], int(args.one[1])
        print(lockstep(algorithm, runs) if runs else plain(algorithm))
        return
    found = {(algorithm, n): [] for algorithm in args.algorithms for n in (0, *args.runs)}
    for turn in range(args.turns):
        for (algorithm, n), speeds in found.items():
            speeds.append(speed(algorithm, n))
            what = f"{algorithm}, {n} in lockstep" if n else f"{algorithm}, plain"
            print(f"turn {turn + 1}: {what}: {speeds[-1]:,.0f}", file=sys.stderr)
    print(f"Environment steps a second of training on {TASK}, all runs together:\n")
    print(table(found, args.algorithms, args.runs))
    print(
        "\nOthers: omnisafe 0.5.0, fast-safe-rl 0.1.0, the own library of the paper's group on\n"
        "Stable-Baselines3 2.7. Measured on another machine: compare with care."
    )


if __name__ == "__main__":
    main()
