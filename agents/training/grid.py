"""Grids of trainings: algorithms on tasks with their presets, each in a folder of its own."""

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
"""In a training of several tasks; more make a step of each hardly cheaper."""
Variants = Callable[[str, str], Mapping[str, Mapping[str, Any]]]
"""(algorithm, task) -> values instead of the preset's, by the ending of their folder."""


def grid(
    out: Path,
    tasks: Sequence[str],
    algorithms: Sequence[str],
    seeds: Sequence[int],
    steps: int | None = None,
    task_parameters: Mapping[str, Any] | None = None,
    variants: Variants | None = None,
) -> dict[Path, TrainConfig]:
    """The trainings of every algorithm on every task with its preset, by folder; what takes longest
    first.

    The folder of an algorithm is `out/ALGORITHM` where all tasks train in it together: they have
    equal presets and spaces, and are few. Otherwise each task has its own, `out/TASK/ALGORITHM`.
    steps: of each run; by default the usual ones of its task. variants: further trainings, in
    folders like trpo-lag-sgd. Raises UserError for what is unknown.
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
    except UserError:  # for one that cannot be made, too, which its training says
        return False
    return True


def shard(folders: Mapping[Path, TrainConfig], part: int, count: int) -> dict[Path, TrainConfig]:
    """The `part`-th of `count` parts of a grid, from 1 on, which take about equally long.

    Depends on nothing that has been trained, so that the parts of a grid have no folder in common.
    """
    order = sorted(folders, key=lambda folder: -work(folders[folder]))  # stable
    return {folder: folders[folder] for folder in order[part - 1 :: count]}


def work(config: TrainConfig) -> float:
    """Time that a training takes, in steps of a run of TRPO-Lag."""
    return algorithm(config.algorithm).work * config.steps * len(config.runs)


LOCKSTEP = 2
"""The runs of a training take as long as so many more of them: what runs in lockstep share."""
NEGLIGIBLE = 0.95
"""Share of the time to which smaller parts must bring it to be worth making."""


def split(folders: Mapping[Path, TrainConfig], workers: int) -> dict[Path, TrainConfig]:
    """The trainings for so many processes at a time, what takes longest first.

    Where processes would wait for the longest, trainings are cut into parts, `FOLDER/K-of-N`, with
    some of their tasks and seeds each; runs have the same numbers alone as among others. What has
    begun stays cut as it is. Raises UserError where that holds other tasks or seeds.
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
            if not found:  # as many parts as these runs are never cut into
                raise UserError(
                    f"{folder} holds {count} parts of a training with other tasks or seeds; choose "
                    "another folder for out"
                )
        own = _parts(config, *found[0])
        named = [folder / f"{k}-of-{len(own)}" for k in range(1, len(own) + 1)]
        parts |= zip(named if len(own) > 1 else [folder], own, strict=True)
    return dict(sorted(parts.items(), key=lambda pair: -work(pair[1])))


def _cuts(config: TrainConfig) -> list[tuple[int, int]]:
    """Into how many parts its tasks and its seeds may be cut: each time more, the largest of which
    is smaller."""
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
    """The training in so many parts."""

    pairs = itertools.product(_pieces(config.tasks, tasks), _pieces(config.seeds, seeds))
    return [dataclasses.replace(config, tasks=own, seeds=few) for own, few in pairs]


def _pieces(items: tuple, count: int) -> list[tuple]:
    """So many pieces of about equal length."""
    ends = [len(items) * k // count for k in range(count + 1)]
    return [items[start:end] for start, end in itertools.pairwise(ends)]


def makespan(durations: Sequence[float], workers: int) -> float:
    """When the last of some trainings ends of which the longest that waits goes to the first of the
    workers that is free."""
    free = [0.0] * workers
    for duration in sorted(durations, reverse=True):
        heapq.heapreplace(free, free[0] + duration)
    return max(free)


def prepare(folders: Mapping[Path, TrainConfig]) -> None:
    """Make the folders that are not there yet.

    Raises UserError, before anything is made, where one holds runs of another configuration, or
    one cannot be made: else the others would keep the settings of a call that failed.
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
