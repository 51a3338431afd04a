"""Compare ten seeds of an older version of this package with ten of this one, at equal length.

    git worktree add ../before 81307c5
    python benchmarks/ten_seeds.py --before ../before --out FOLDER

Trains three algorithms on three tasks with both versions, unless FOLDER has the runs, and compares
all measures that a report shows, and the mean return of training's last third. The rule: seeds are
disjoint, so that the two sets are independent; a permutation test of equal means for each measure,
algorithm and task, exact over all 184 756 divisions; Holm's correction over all tests of the table.
The versions differ where a corrected p value is at most 0.05.
"""

import argparse
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

import agents
from emcc.statistics import holm, mean_difference, permutation_test

ALGORITHMS = ("ppo-lag", "trpo-lag", "sac-lag")
GOAL = "SafetyPointGoal1-v0"
STEPS = {"Circle2D-1-v0": 100_000, "Circle2D-2-v0": 100_000, GOAL: 30_000}
SEEDS = {"before": range(10), "now": range(100, 110)}
LEARNS = ["--random-steps", "5000", "--gradient-steps", "100"]
"""For SAC-Lag on PointGoal1: with the preset, most actions of so short a training are random."""


def train(out, algorithm, task, side, checkout):
    """Train the ten runs of a side, unless done; return their folder."""
    folder = out / f"{algorithm} {task} {side}"
    if not (folder / "results.npz").exists():
        command = ["resume", str(folder)]
        if not folder.exists():
            command = ["train", algorithm, "--task", task, "--out", str(folder)]
            command += ["--steps", str(STEPS[task]), "--seeds", *map(str, SEEDS[side])]
            command += ["--evaluation-episodes", "5" if task == GOAL else "100"]
            command += LEARNS if (algorithm, task) == ("sac-lag", GOAL) else []
        own = os.environ | {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(Path(checkout).resolve())}
        command = [sys.executable, "-P", "-m", "agents.cli", *command]
        subprocess.run(command, env=own, check=True, stdout=sys.stderr)
    return folder


def measures(folder):
    """Return the measures of a folder's runs, a row for each run."""
    runs = agents.load_runs(folder)
    frame = runs.to_pandas()
    part = frame["part"].map(lambda end: "" if np.isnan(end) else f" to {end:.2f}")
    frame["measure"] += part  # EMCC of a third
    table = frame.pivot(index="seed", columns="measure", values="value")
    for (_, seed), records in runs.records.items():
        late = np.cumsum(records.length) > 2 / 3 * records.length.sum()
        table.loc[seed, "training_return"] = records.reward[late].mean()
    return table


def main():
    """Train what is missing, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--before", required=True, metavar="CHECKOUT", help="of the older version")
    parser.add_argument("--out", required=True, type=Path)
    parser.add_argument("--algorithms", nargs="+", default=ALGORITHMS)
    parser.add_argument("--tasks", nargs="+", default=STEPS)
    options = parser.parse_args()
    sides = {"before": options.before, "now": Path(__file__).parent.parent}
    cases = [(algorithm, task) for task in options.tasks for algorithm in options.algorithms]
    rng, rows = np.random.default_rng(0), []
    for case in cases:
        folders = [train(options.out, *case, *side) for side in sides.items()]
        before, now = map(measures, folders)
        for measure in before.columns.intersection(now.columns):
            pair = (before[measure].dropna().to_numpy(), now[measure].dropna().to_numpy())
            by, p = mean_difference(*pair), permutation_test(*pair, rng=rng)
            rows.append((*case, measure, pair[0].mean(), by, p))
    corrected = holm([row[-1] for row in rows])
    print("| algorithm | task | measure | before | difference | p | corrected |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for (*names, mean, by, p), after in zip(rows, corrected, strict=True):
        interval = f"{by.value:+.3g} [{by.low:.3g}, {by.high:.3g}]"
        cells = [*names, f"{mean:.3g}", interval, f"{p:.3f}", f"{after:.3f}"]
        print(f"| {' | '.join(cells)} |")
    p = np.array([row[-1] for row in rows])
    low, most = (p <= 0.05).sum(), (corrected <= 0.05).sum()
    print(
        f"\n{len(p)} tests: p is at most 0.05 in {low}, where {0.05 * len(p):.1f} are expected of"
    )
    print(f"equal versions; after Holm's correction in {most}.")


if __name__ == "__main__":
    main()
