"""Grids of trainings: algorithms on tasks with their presets, each in its own folder."""

from __future__ import annotations

import dataclasses
import functools
import heapq
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from agents.algorithms import algorithm
from agents.errors import UserError
from agents.presets import preset_with, usual_steps
from agents.training.config import CONFIG, TrainConfig, file_name
from agents.training.environments import spaces_of

MOST_RUNS = 12
"""Most runs in a training of several tasks; with more, a step of each is hardly cheaper."""
Variants = Callable[[str, str], Mapping[str, Mapping[str, Any]]]
"""(algorithm, task) -> for each suffix of a folder's name, values that replace the preset's."""


def grid(
    out: Path,
    tasks: Sequence[str],
    algorithms: Sequence[str],
    seeds: Sequence[int],
    steps: int | None = None,
    task_parameters: Mapping[str, Any] | None = None,
    variants: Variants | None = None,
) -> dict[Path, TrainConfig]:
    """Return the trainings of every algorithm on every task by folder, longest training first.

    All tasks of an algorithm train together in `out/ALGORITHM` if they have equal presets and
    spaces, and are few. Otherwise each task has its own folder, `out/TASK/ALGORITHM`. steps:
    environment steps of each run, by default the usual number of its task. variants: further
    trainings, in folders such as trpo-lag-sgd. Raises UserError for unknown tasks, algorithms or
    hyper-parameters.
    """
    tasks = list(dict.fromkeys(tasks))
    order = sorted(dict.fromkeys(algorithms), key=lambda name: -algorithm(name).work)
    trainings = {}
    for name in order:
        choices: dict[str, dict[str, Any]] = {}  # hyper-parameters by folder, then task
        for task in tasks:
            others = variants(name, task) if variants else {}
            changed = {name: {}} | {f"{name}-{ending}": v for ending, v in others.items()}
            for folder, values in changed.items():
                choices.setdefault(folder, {})[task] = preset_with(name, task, values)
        for folder, by_task in choices.items():
            lengths = {task: steps or usual_steps(task) for task in by_task}
            alike = len({repr((by_task[task], lengths[task])) for task in by_task}) == 1
            few = len(by_task) > 1 and len(by_task) * len(seeds) <= MOST_RUNS
            if alike and few and _equal_spaces(tuple(by_task)):
                parts = {out / folder: list(by_task)}
            else:
                parts = {out / file_name(task) / folder: [task] for task in by_task}
            for path, together in parts.items():
                length, own = lengths[together[0]], by_task[together[0]]
                parameters = dict(task_parameters or {})
                trainings[path] = TrainConfig(
                    name, tuple(together), tuple(seeds), length, own, parameters
                )
    return trainings


@functools.cache
def _equal_spaces(tasks: tuple[str, ...]) -> bool:
    """Whether tasks can train together."""
    try:
        spaces_of(tasks, {})
    except UserError:  # also for a task that cannot be made: its training reports that
        return False
    return True


def shard(folders: Mapping[Path, TrainConfig], part: int, count: int) -> dict[Path, TrainConfig]:
    """Return the `part`-th, from 1, of `count` parts of a grid, which take about equally long.

    The result does not depend on what has been trained, so that parts share no folder.
    """
    order = sorted(folders, key=lambda folder: -work(folders[folder]))  # stable
    return {folder: folders[folder] for folder in order[part - 1 :: count]}


def work(config: TrainConfig) -> float:
    """Return the time that a training takes, in units of an environment step of TRPO-Lag."""
    return algorithm(config.algorithm).work * config.steps * len(config.runs)


LOCKSTEP = 2
"""Overhead of a training, in runs: what its runs in lockstep share takes as long as so many."""
NEGLIGIBLE = 0.95
"""Smaller parts are made only if they reduce the time below this share of it."""


def split(folders: Mapping[Path, TrainConfig], workers: int) -> dict[Path, TrainConfig]:
    """Cut trainings for so many processes at a time; return the parts, longest first.

    Where processes would wait for the longest training, trainings are cut into parts,
    `FOLDER/K-of-N`, each with some of their tasks and seeds; the numbers of a run do not depend on
    the runs beside it. Trainings that have begun stay cut as they are. Raises UserError if their
    folders hold other tasks or seeds.
    """
    numbers = {folder: _cuts(config) for folder, config in folders.items()}
    share = {f: work(config) / len(config.runs) for f, config in folders.items()}

    def duration(folder: Path, runs: int) -> float:
        return share[folder] * (runs + LOCKSTEP)

    def sizes(folder: Path) -> list[int]:
        tasks, seeds = numbers[folder][cut[folder]]
        config = folders[folder]
        pairs = itertools.product(_pieces(config.tasks, tasks), _pieces(config.seeds, seeds))
        return [len(own) * len(few) for own, few in pairs]

    cut, chosen, best, idle = dict.fromkeys(folders, 0), {}, math.inf, 0
    runs = {folder: sizes(folder) for folder in folders}
    while folders:
        takes = makespan([duration(f, n) for f, own in runs.items() for n in own], workers)
        if takes < NEGLIGIBLE * best:
            chosen, best, idle = dict(cut), takes, workers - sum(map(len, runs.values()))
        longest = max(runs, key=lambda folder: duration(folder, max(runs[folder])))
        if cut[longest] + 1 == len(numbers[longest]):
            break
        cut[longest] += 1
        runs[longest] = sizes(longest)
    for folder in sorted(folders, key=lambda folder: -work(folders[folder])):  # for idle workers
        for k, own in list(enumerate(numbers[folder]))[chosen[folder] + 1 :]:
            more = math.prod(own) - math.prod(numbers[folder][chosen[folder]])
            if more <= idle:
                chosen[folder], idle = k, idle - more
    parts = {}
    for folder, config in folders.items():
        begun = next(folder.glob(f"*-of-*/{CONFIG}"), None)
        found = [numbers[folder][chosen[folder]]]
        if (folder / CONFIG).exists():
            found = [(1, 1)]
        elif begun is not None:
            count = int(begun.parent.name.rpartition("-")[2])
            found = [n for n in numbers[folder] if math.prod(n) == count]
            if not found:  # these runs are never cut into so many parts
                raise UserError(
                    f"{folder} holds {count} parts of a training with other tasks or seeds; choose "
                    "another folder for out"
                )
        own = _parts(config, *found[0])
        named = [folder / f"{k}-of-{len(own)}" for k in range(1, len(own) + 1)]
        parts |= zip(named if len(own) > 1 else [folder], own, strict=True)
    return dict(sorted(parts.items(), key=lambda pair: -work(pair[1])))


def _cuts(config: TrainConfig) -> list[tuple[int, int]]:
    """Return into how many parts tasks and seeds may be cut, in increasing order of the number of
    parts; each cut has a smaller largest part than the one before."""
    counts = itertools.product(range(1, len(config.tasks) + 1), range(1, len(config.seeds) + 1))
    cuts: list[tuple[int, int]] = []
    smallest = math.inf
    for tasks, seeds in sorted(counts, key=math.prod):
        largest = -(-len(config.tasks) // tasks) * -(-len(config.seeds) // seeds)
        if largest < smallest:
            cuts, smallest = [c for c in cuts if math.prod(c) < tasks * seeds], largest
            cuts.append((tasks, seeds))
    return cuts


def _parts(config: TrainConfig, tasks: int, seeds: int) -> list[TrainConfig]:
    """Cut a training into parts: its tasks into so many pieces, and its seeds."""

    pairs = itertools.product(_pieces(config.tasks, tasks), _pieces(config.seeds, seeds))
    return [dataclasses.replace(config, tasks=own, seeds=few) for own, few in pairs]


def _pieces(items: tuple, count: int) -> list[tuple]:
    """Cut items into so many pieces of about equal length."""
    ends = [len(items) * k // count for k in range(count + 1)]
    return [items[start:end] for start, end in itertools.pairwise(ends)]


def makespan(durations: Sequence[float], workers: int) -> float:
    """Return when the last training ends if each free worker takes the longest one that waits."""
    free = [0.0] * workers
    for duration in sorted(durations, reverse=True):
        heapq.heapreplace(free, free[0] + duration)
    return max(free)


def prepare(folders: Mapping[Path, TrainConfig]) -> None:
    """Make the folders that do not exist yet.

    Raises UserError if a folder holds runs of another configuration or cannot be made. This is
    checked before any folder is made: the others would keep the settings of a call that failed.
    """
    there = [folder for folder in folders if (folder / CONFIG).exists()]
    for folder in there:
        theirs, ours = TrainConfig.read(folder).settings, folders[folder].settings
        changed = [
            f"{k} {theirs.get(k, 'absent')} (now {ours.get(k, 'absent')})"
            for k in theirs | ours
            if repr(theirs.get(k)) != repr(ours.get(k))
        ]
        if changed:
            raise UserError(
                f"{folder} holds runs with other settings: {', '.join(changed)}; choose another "
                "folder for out"
            )
    new = {folder: config.checked() for folder, config in folders.items() if folder not in there}
    for folder, spaces in new.items():
        folders[folder].write(folder, spaces)
