"""Runs on the disk: records of a small training, written by hand; what a training left."""

import json

import numpy as np

from agents.paper.presets import preset
from agents.results.reading import Group, Run
from agents.results.source import FolderSource
from agents.training.config import TrainConfig
from emcc import EpisodeRecords

TASK = "Circle2D-3-v0"
# Of 12 rollouts with two episodes of 5 steps each, 120 steps: the longest streaks.
STREAKS = [(0, 4), (5, 1), (2, 2), (3, 0), (5, 5), (1, 0), (2, 4), (0, 0), (1, 1), (3, 2), (2, 2)]
STREAKS += [(0, 1)]


def write_runs(folder, task=TASK):
    """Two runs on a task: what they recorded, and no checkpoint."""
    config = TrainConfig("sac-lag", task, (0, 1), 120, preset("sac-lag", task))
    config.write(folder)
    for seed in (0, 1):
        lines = ["rollout,start_step,length,return,cost,longest_streak"]
        for k, streaks in enumerate(STREAKS):
            for e, streak in enumerate(streaks):
                lines.append(f"{k},{10 * k + 5 * e},5,-1.0,{streak}.0,{streak}")
        (folder / f"seed-{seed}" / "episodes.csv").write_text("\n".join([*lines, ""]))
        rows = np.arange(240, dtype=np.float32).reshape(120, 2) / 100 + seed
        np.save(folder / f"seed-{seed}" / "visited.npy", rows)
    return config


NO_RESULTS = ("status.json", "report.md", "report.csv", "checkpoint.previous.npz", "checksums.json")
"""Timings, the command's table, and what depends on where a training was interrupted."""


def results(folder):
    """The bytes of every file but those of `NO_RESULTS`."""
    found = sorted(path for path in folder.rglob("*") if path.is_file())
    kept = (path for path in found if path.name not in NO_RESULTS)
    return {str(path.relative_to(folder)): path.read_bytes() for path in kept}


def write_evaluated(
    folder, name, costs, hyperparameters=None, old=False, task="Circle2D-1-v0", seeds=None
):
    """Evaluated runs of ten episodes of ten steps, with as many steps at a cost in
    each episode, in one chain: one run for each number in `costs`, of the seeds 0, 1, ... where
    none are given.

    old: as before cost steps and streaks were recorded.
    """
    seeds = tuple(seeds or range(len(costs)))
    TrainConfig(name, task, seeds, 100, hyperparameters or preset(name, task)).write(folder)
    head = "rollout,start_step,length,return,cost,longest_streak"
    for seed, cost in zip(seeds, costs, strict=True):
        lines = [head + ("" if old else ",cost_steps,streaks")]
        more = "" if old else f",{cost},1"
        lines += [f"{k},{10 * k},10,-1.0,{cost}.0,{5 if old else cost}{more}" for k in range(10)]
        (folder / f"seed-{seed}" / "episodes.csv").write_text("\n".join([*lines, ""]))
        of = {"J_R": -9.0, "J_C": 4.25, "CVaR_0.5": 6.5, "final_observations": [[1.0, 0.0]]}
        content = {"episodes": 1, "deterministic": of, "stochastic": of}
        (folder / f"seed-{seed}" / "evaluation.json").write_text(json.dumps(content))


def write_status(folder, share, speed=None, **sessions):
    """`status.json` of a training; sessions: seconds that each process took."""
    content = {"share": share, "steps_per_second": speed, "sessions": sessions}
    (folder / "status.json").write_text(json.dumps(content))


def group_of(folder, config, seeds=None, measures=None, **more):
    """The group of runs of a folder that were not evaluated, with the steps they recorded."""
    seeds = config.seeds if seeds is None else seeds
    records = [EpisodeRecords.load(folder / f"seed-{k}" / "episodes.csv") for k in seeds]
    runs = [Run(k, measures or {}, 100, {}, r) for k, r in zip(seeds, records, strict=True)]
    title = f"{folder.parent.name}/{folder.name}"
    source = FolderSource(folder.parent)
    return Group(folder.name, config, runs, title=title, source=source, **more)
