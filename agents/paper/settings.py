"""The settings of runs beside the paper's: what differs, and how runs are named by it."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

from agents.algorithms import ALGORITHMS, title
from agents.paper.presets import preset, usual_steps
from agents.results.reading import Group
from agents.training.config import TrainConfig


def with_distinct_titles(groups: Sequence[Group]) -> list[Group]:
    """Groups; those of one title on one task get their folders into their names."""
    keys = [(group.config.task, title_of(group.config)) for group in groups]
    count = Counter(key for key, group in zip(keys, groups, strict=True) if group.runs)
    return [
        dataclasses.replace(group, apart=f"in {group.title}" if count[k] > 1 else "")
        for k, group in zip(keys, groups, strict=True)
    ]


def name_of(group: Group) -> str:
    """The title of a group, with what tells it apart from another of that title."""
    return title_of(group.config, group.apart)


def title_of(config: TrainConfig, more: str = "") -> str:
    """The algorithm, with what differs from the preset, from the task as it is registered, and from
    the usual number of steps."""
    settings = [*differences(config), *filter(None, [more])]
    return title(config.algorithm) + (f" ({', '.join(settings)})" if settings else "")


def differences(config: TrainConfig) -> list[str]:
    """Each setting of `changes` in words, and the number of steps where it is not the usual one. Of
    an unregistered algorithm, whose preset nobody knows, no hyper-parameter."""
    of = changes(config) if config.algorithm in ALGORITHMS else config.task_parameters
    return [f"{k} {v}" for k, v in of.items()] + unusual_steps(config)


def unusual_steps(config: TrainConfig) -> list[str]:
    """The training's length, where it is not the usual one: see `presets.usual_steps`."""
    return [] if config.steps == usual_steps(config.task) else [f"{config.steps:,} steps"]


def changes(config: TrainConfig) -> dict[str, Any]:
    """Settings that differ from the preset and from the task as it is registered."""
    return hyperparameter_changes(config) | config.task_parameters


def hyperparameter_changes(config: TrainConfig) -> dict[str, Any]:
    """The hyper-parameters that differ from the preset; all of an unregistered algorithm."""
    chosen = dataclasses.asdict(config.hyperparameters)
    if config.algorithm not in ALGORITHMS:
        return chosen
    usual = dataclasses.asdict(preset(config.algorithm, config.task))
    return {k: v for k, v in chosen.items() if v != usual[k]}


def cost_limit(config: TrainConfig) -> float | None:
    """The cost limit of an algorithm's hyper-parameters; None for one without constraints."""
    return getattr(config.hyperparameters, "cost_limit", None)


def in_order(groups: Iterable[Group]) -> list[Group]:
    """Groups in the order of the algorithms."""
    order = {name: index for index, name in enumerate(ALGORITHMS)}
    return sorted(groups, key=lambda group: order.get(group.config.algorithm, len(order)))


def by_task(groups: Iterable[Group]) -> dict[str, list[Group]]:
    """Groups with complete runs by their task, in the order of the algorithms."""
    found: dict[str, list[Group]] = {}
    for group in in_order(groups):
        if group.runs:
            found.setdefault(group.config.task, []).append(group)
    return dict(sorted(found.items()))
