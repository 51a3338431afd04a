"""The paper's experiments as data: which runs there are, in which order, and what is done."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise
from math import ceil
from pathlib import Path

from agents.errors import UserError
from agents.paper.presets import PAPER_SEEDS, preset, usual_steps
from agents.paper.presets import ablations as ablations_of
from agents.training.config import FAILURE, Backend, Device, TrainConfig, read_spaces, run_folder
from agents.training.files import read_json
from agents.training.status import share_done
from agents.training.workers import Group
from circle2d_mj.circle2d.config import LEVELS
from circle2d_mj.registration import KINEMATIC, PHYSICS
from emcc import EpisodeRecords

SEEDS = tuple(range(PAPER_SEEDS))
QUICK_SEEDS, QUICK_STEPS = (0, 1), 10_000
WORK = {"trpo-lag": 1.0, "cpo": 1.3, "sac-lag": 5.0, "sac-lb": 5.0, "wcsac": 5.2}
WORK |= {"ppo-lag": 2.4, "ppo": 2.4, "sac": 4.8, "sac-lb-streak": 7.5}
UNKNOWN_WORK = max(WORK.values())
"""Time of a step of an algorithm on Circle2D, in that of TRPO-Lag's; of one that is not listed the
largest. Decides the order (what takes longest goes first), the groups and the time left that is
shown; no result."""
MOST_RUNS = 12
"""In a group; more make a step of each hardly cheaper."""
OVERHEAD = 2
"""A step of a group takes what this many runs more would take, by the difference between 3 runs and
12 (`benchmarks/training_speed.py`). Decides the groups; no result."""


def circle2d_tasks(levels: Sequence[int], mujoco: bool) -> list[str]:
    """The ids of Circle2D on some levels, kinematic or with physics. Raises UserError."""
    if not levels or not set(levels) <= set(LEVELS):
        raise UserError(f"levels must be some of {list(LEVELS)}, got {list(levels)}")
    ids = PHYSICS if mujoco else KINEMATIC
    return [ids[level] for level in dict.fromkeys(levels)]


def grid(
    out: Path,
    tasks: Sequence[str],
    algorithms: Sequence[str],
    seeds: Sequence[int],
    steps: int | None = None,
    device: Device = "cpu",
    ablations: bool = False,
) -> dict[Path, TrainConfig]:
    """The runs of every algorithm on every task with its preset, by folder; what takes longest
    first. The seeds of a folder train in lockstep.

    steps: of each run; by default the usual ones of its task. ablations: those with other choices
    of what the paper does not print as well, in folders like trpo-lag-sgd. Raises UserError for
    what is unknown. Of eager updates, until a backend is chosen.
    """
    order = sorted(dict.fromkeys(algorithms), key=lambda name: -WORK.get(name, UNKNOWN_WORK))
    found = {}
    for name in order:
        for task in dict.fromkeys(tasks):
            chosen = {name: preset(name, task)}
            if ablations:
                others = ablations_of(name, task).items()
                chosen |= {f"{name}-{choice}": config for choice, config in others}
            of_each = usual_steps(task) if steps is None else steps
            # Twenty checkpoints at the most: those of a long off-policy training hold gigabytes.
            every = max(50_000, of_each // 20)
            for folder, hyperparameters in chosen.items():
                config = TrainConfig(name, task, tuple(seeds), of_each, hyperparameters)
                config = replace(config, checkpoint_every=every, device=device)
                found[out / task.replace("/", "-") / folder] = config
    return found


def shard(folders: dict[Path, TrainConfig], part: int, count: int) -> dict[Path, TrainConfig]:
    """The `part`-th of `count` parts of a grid, from 1 on, which take about equally long.

    Depends on nothing that has been trained, so that the parts of a grid have no folder in common.
    """
    order = sorted(folders, key=lambda folder: -_time((folder,), folders))  # stable
    return {folder: folders[folder] for folder in order[part - 1 :: count]}


def backend_of(folders: Iterable[Path]) -> Backend | None:
    """Backend that the runs of a grid began with; None where there are no runs yet."""
    there = (folder for folder in folders if (folder / "config.json").exists())
    return next((TrainConfig.read(folder).backend for folder in there), None)


def prepare(folders: dict[Path, TrainConfig]) -> None:
    """Make the folders that are not there yet.

    Raises UserError, before anything is made, where one holds runs of another configuration.
    """
    there = [folder for folder in folders if (folder / "config.json").exists()]
    for folder in there:
        theirs, ours = TrainConfig.read(folder).settings, folders[folder].settings
        changed = [
            f"{k} {theirs.get(k, 'absent')} (now {ours.get(k, 'absent')})"
            for k in theirs | ours
            if theirs.get(k) != ours.get(k)
        ]
        if changed:
            raise UserError(
                f"{folder} holds runs with other settings: {', '.join(changed)}; choose another "
                "folder for out"
            )
    for folder, config in folders.items():
        if folder not in there:
            config.write(folder)


def groups(configs: dict[Path, TrainConfig], workers: int) -> list[Group]:
    """Groups of folders that train together, a process each, the longest first.

    The folders are there: see `prepare`. Those of equal settings and sizes that have come equally
    far are dealt evenly into groups of 12 runs at most: as large as may be while that keeps all
    workers busy to the end.
    """
    kinds = _kinds(configs)
    largest = range(max(map(len, kinds), default=0), 0, -1)

    def dealt(sizes: Sequence[int]) -> list[Group]:
        found = [
            group
            for kind, size in zip(kinds, sizes, strict=True)
            for group in _dealt(kind, configs, size)
        ]
        return sorted(found, key=lambda group: -_time(group, configs))

    def end(sizes: Sequence[int]) -> float:
        return _end([_time(group, configs) for group in dealt(sizes)], workers)

    sizes = min(([size] * len(kinds) for size in largest), key=end, default=[])
    for k in range(len(kinds)):  # then each kind its own size
        sizes = min(([*sizes[:k], size, *sizes[k + 1 :]] for size in largest), key=end)
    return dealt(sizes)


def _kinds(configs: dict[Path, TrainConfig]) -> list[list[Path]]:
    """Folders that could train together."""
    kinds: dict[str, list[Path]] = {}
    for folder, config in configs.items():
        sizes = read_spaces(folder, config).sizes
        kind = repr((config.shared, sizes, round(share_done(folder), 2)))
        kinds.setdefault(kind, []).append(folder)
    return list(kinds.values())


def _dealt(kind: list[Path], configs: dict[Path, TrainConfig], most: int) -> list[Group]:
    """Folders in groups as equal as may be, of `most` folders and 12 runs at most."""
    runs = max(len(configs[folder].seeds) for folder in kind)
    count = ceil(len(kind) / min(most, max(1, MOST_RUNS // runs)))
    ends = [len(kind) * k // count for k in range(count + 1)]
    return [tuple(kind[a:b]) for a, b in pairwise(ends)]


def _time(group: Group, configs: dict[Path, TrainConfig]) -> float:
    """Time that a group trains, in steps of a run of TRPO-Lag."""
    config = configs[group[0]]
    runs = sum(len(configs[folder].seeds) for folder in group)
    return WORK.get(config.algorithm, UNKNOWN_WORK) * config.steps * (runs + OVERHEAD)


def _end(times: Sequence[float], workers: int) -> float:
    """When the last of the workers is done, of which one that is free takes what is next."""
    busy = [0.0] * workers
    for time in times:
        busy.sort()
        busy[0] += time
    return max(busy)


def finished(folder: Path, config: TrainConfig) -> bool:
    """Whether all runs of a folder have ended, also by a failure."""
    return all(_finished(run_folder(folder, seed), config.steps) for seed in config.seeds)


def has_failures(folder: Path, config: TrainConfig) -> bool:
    """Whether a run of a folder stopped at a NaN or an infinite number."""
    return any((run_folder(folder, seed) / FAILURE).exists() for seed in config.seeds)


def _finished(folder: Path, steps: int) -> bool:
    if (folder / FAILURE).exists():
        return True
    try:
        read_json(folder / "evaluation.json")
        return EpisodeRecords.load(folder / "episodes.csv").total_steps >= steps
    except (OSError, ValueError):
        return False


def work_left(shares: dict[Path, float], configs: dict[Path, TrainConfig]) -> tuple[float, float]:
    """Work done and work in all, in steps of TRPO-Lag. shares: how much of each folder is done."""
    total = {
        folder: WORK.get(config.algorithm, UNKNOWN_WORK) * config.steps * len(config.seeds)
        for folder, config in configs.items()
    }
    done = sum(shares.get(folder, 0.0) * work for folder, work in total.items())
    return done, sum(total.values())


def seconds_left(elapsed: float, before: float, done: float, total: float) -> float | None:
    """Seconds that the rest of some work takes at its mean pace so far; None where there is none.

    elapsed: seconds since a time at which `before` of the `total` was done; done: of it now.
    """
    return elapsed * (total - done) / (done - before) if done > before else None
