"""Groups of runs by name, in order, and as one tidy frame."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

from agents.algorithms import ALGORITHMS, title
from agents.paper.presets import preset, usual_steps  # the settings that runs are named against
from agents.results.measures import measures
from agents.results.reading import Group
from agents.training.config import TrainConfig

if TYPE_CHECKING:
    import pandas

COLUMNS = ("group", "task", "algorithm", "settings", "cost", "folder", "seed", "ends_in")
COLUMNS = (*COLUMNS, "measure", "part", "value")


def frame(groups: Sequence[Group]) -> pandas.DataFrame:
    """A row for each complete run and measure.

    group: number of the runs that differ in their seeds alone, for group-bys. settings: those that
    are not the preset's, in words. cost: that the measures are of. ends_in: where most evaluated
    episodes end, empty for a task without named places. part: end of the third of training that the
    measure is of, NaN for one of the whole. value: NaN where the run lacks it.
    """
    import pandas as pd

    rows = [
        (
            *(number, group.task, group.config.algorithm, settings_of(group), group.cost),
            group.folder,
            *(run.seed, run.place, m.stem, m.part, run.measures.get(m.name)),
        )
        for number, group in enumerate(groups)
        for run in group.runs
        for m in measures()
    ]
    made = pd.DataFrame(rows, columns=list(COLUMNS))
    return made.astype({"part": float, "value": float})


def with_distinct_titles(groups: Sequence[Group]) -> list[Group]:
    """Groups of which those of one title on one task have their folders in their names."""
    keys = [(group.task, group.cost, title_of(group.config, group.task)) for group in groups]
    count = Counter(key for key, group in zip(keys, groups, strict=True) if group.runs)
    return [
        dataclasses.replace(
            group,
            apart=", ".join(filter(None, [group.apart, f"in {group.title}" * (count[key] > 1)])),
        )
        for key, group in zip(keys, groups, strict=True)
    ]


def name_of(group: Group) -> str:
    """The title of a group, with what tells it apart from another of that title."""
    return title_of(group.config, group.task, group.apart)


def title_of(config: TrainConfig, task: str, more: str = "") -> str:
    """The algorithm, with the settings that are not the usual ones."""
    words = ", ".join(filter(None, [*differences(config, task), more]))
    return title(config.algorithm) + (f" ({words})" if words else "")


def settings_of(group: Group) -> str:
    """The settings of a group that are not the usual ones, in words."""
    return ", ".join(filter(None, [*differences(group.config, group.task), group.apart]))


def differences(config: TrainConfig, task: str) -> list[str]:
    """Each setting of `changes` in words, and the number of steps where it is not the usual one. Of
    an unregistered algorithm, whose preset nobody knows, no hyper-parameter."""
    known = config.algorithm in ALGORITHMS
    changed = changes(config, task) if known else config.task_parameters
    return [f"{name} {value}" for name, value in changed.items()] + unusual_steps(config, task)


def unusual_steps(config: TrainConfig, task: str) -> list[str]:
    """The training's length, where it is not the usual one: see `presets.usual_steps`."""
    return [] if config.steps == usual_steps(task) else [f"{config.steps:,} steps"]


def changes(config: TrainConfig, task: str) -> dict[str, Any]:
    """Settings that differ from the preset and from the task as it is registered."""
    return hyperparameter_changes(config, task) | config.task_parameters


def hyperparameter_changes(config: TrainConfig, task: str) -> dict[str, Any]:
    """The hyper-parameters that differ from the preset; all of an unregistered algorithm."""
    chosen = dataclasses.asdict(config.hyperparameters)
    if config.algorithm not in ALGORITHMS:
        return chosen
    usual = dataclasses.asdict(preset(config.algorithm, task))
    return {name: value for name, value in chosen.items() if value != usual[name]}


def in_order(groups: Iterable[Group]) -> list[Group]:
    """Groups in the order of the algorithms."""
    order = {name: index for index, name in enumerate(ALGORITHMS)}
    return sorted(groups, key=lambda group: order.get(group.config.algorithm, len(order)))


def by_task(groups: Iterable[Group]) -> dict[str, list[Group]]:
    """Groups with complete runs by their task, in the order of the algorithms."""
    tasks: dict[str, list[Group]] = {}
    for group in in_order(groups):
        if group.runs:
            tasks.setdefault(group.task, []).append(group)
    return dict(sorted(tasks.items()))
