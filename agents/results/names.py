"""Names of runs, from their algorithm and its unusual settings, and the order of runs."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

from agents.algorithms import ALGORITHMS, title
from agents.presets import preset, usual_steps
from agents.training.config import TrainConfig

if TYPE_CHECKING:
    from agents.results.groups import Group

MOST_CHARACTERS = 40
"""Longest value of a setting, in characters, that a name spells out."""


def with_names(groups: Sequence[Group], among: Sequence[Group] | None = None) -> list[Group]:
    """Return the groups with names that tell them apart.

    An unregistered algorithm has no preset to compare with: its groups are named by the
    hyper-parameters in which they differ within `among`, by default `groups`. Groups that would
    have the same name on a task also get their folders' names. Names leave out the length of runs
    if on each task all runs of `among` have one length.
    """
    among = groups if among is None else among
    lengths: dict[str, set[int]] = {}
    for group in (group for group in among if group.runs):
        lengths.setdefault(group.task, set()).add(group.total_steps)
    one_length = all(len(own) == 1 for own in lengths.values())
    keys = [(group.task, group.cost, group.variant) for group in groups]
    count = Counter(key for key, group in zip(keys, groups, strict=True) if group.runs)
    named = []
    for key, group in zip(keys, groups, strict=True):
        words = [*_varied(group, among), group.apart]
        where = f"in {group.title}" if count[key] > 1 else ""
        apart = ", ".join(filter(None, words))
        told = {"apart": apart, "where": where, "one_length": one_length}
        named.append(dataclasses.replace(group, **told))
    return named


def _varied(group: Group, among: Sequence[Group]) -> list[str]:
    name, own = group.config.algorithm, vars(group.config.hyperparameters)
    if name in ALGORITHMS:
        return []
    others = [vars(g.config.hyperparameters) for g in among if g.config.algorithm == name]
    return [setting(k, v) for k, v in own.items() if any(o.get(k) != v for o in others)]


def titled(algorithm: str, words: Iterable[str]) -> str:
    """Return the title of an algorithm, followed by the words in brackets, if any."""
    told = ", ".join(filter(None, words))
    return title(algorithm) + (f" ({told})" if told else "")


def title_of(config: TrainConfig, task: str, steps: int | None = None) -> str:
    """Return the algorithm with its unusual settings and length.

    steps: environment steps taken, by default those asked for."""
    words = unusual_settings(config, task) + unusual_steps(steps or config.steps, task)
    return titled(config.algorithm, words)


def unusual_settings(config: TrainConfig, task: str) -> list[str]:
    """Return each setting of `changes` in words, but no hyper-parameter of an unregistered
    algorithm: see `with_names`."""
    known = config.algorithm in ALGORITHMS
    changed = changes(config, task) if known else config.task_parameters
    return [setting(name, value) for name, value in changed.items()]


def setting(name: str, value: Any) -> str:
    """Return a setting as names show it. For a value too long for a table's row that is its number
    of entries or characters; a note below the table has the value."""
    if len(str(value)) <= MOST_CHARACTERS or not isinstance(value, (tuple, list, dict, str)):
        return f"{name} {value}"
    return f"{name} [{len(value)}{' characters' * isinstance(value, str)}]"


def unusual_steps(steps: int, task: str) -> list[str]:
    """Return a training's length in words if it is unusual, else []: see `presets.usual_steps`."""
    return [] if steps == usual_steps(task) else [f"{steps:,} steps"]


def changes(config: TrainConfig, task: str) -> dict[str, Any]:
    """Return the settings that differ from the preset and from the registered task."""
    return hyperparameter_changes(config, task) | config.task_parameters


def hyperparameter_changes(config: TrainConfig, task: str) -> dict[str, Any]:
    """Return the hyper-parameters that differ from the preset; all of an unregistered algorithm."""
    chosen = dataclasses.asdict(config.hyperparameters)
    if config.algorithm not in ALGORITHMS:
        return chosen
    usual = dataclasses.asdict(preset(config.algorithm, task))
    return {name: value for name, value in chosen.items() if value != usual[name]}


def in_order(groups: Iterable[Group]) -> list[Group]:
    """Sort groups as their folders were given one by one, or else by the order of algorithms."""
    order = {name: index for index, name in enumerate(ALGORITHMS)}

    def place(group: Group) -> int:
        of_algorithm = order.get(group.config.algorithm, len(order))
        return of_algorithm if group.place is None else group.place

    return sorted(groups, key=place)


def publications(groups: Iterable[Group]) -> str:
    """Return the publications with printed numbers for the groups, like "the paper"; "" if none."""
    names = (group.publication.partition(" (")[0] or "print" for group in groups if group.printed)
    return " and ".join(
        f"the {name}" if name[0].islower() else name for name in dict.fromkeys(names)
    )


def by_task(groups: Iterable[Group]) -> dict[str, list[Group]]:
    """Return the groups with complete runs by task, in the order of `in_order`."""
    tasks: dict[str, list[Group]] = {}
    for group in in_order(groups):
        if group.runs:
            tasks.setdefault(group.task, []).append(group)
    return dict(sorted(tasks.items()))
