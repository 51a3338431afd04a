"""Grids of trainings: algorithms on tasks with their presets, each in a folder of its own."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from agents.algorithms import algorithm
from agents.errors import UserError
from agents.presets import preset, usual_steps
from agents.training.config import CONFIG, TrainConfig, file_name
from agents.training.environments import spaces_of

MOST_RUNS = 12
"""In a training of several tasks; more make a step of each hardly cheaper."""
Variants = Callable[[str, str], Mapping[str, Any]]
"""(algorithm, task) -> hyper-parameters beside the preset, by the ending of their folder."""


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
            chosen = {name: preset(name, task)} | {f"{name}-{k}": v for k, v in others.items()}
            for folder, hyperparameters in chosen.items():
                choices.setdefault(folder, {})[task] = hyperparameters
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


def prepare(folders: Mapping[Path, TrainConfig]) -> None:
    """Make the folders that are not there yet.

    Raises UserError, before anything is made, where one holds runs of another configuration.
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
    for folder, config in folders.items():
        if folder not in there:
            config.write(folder)
