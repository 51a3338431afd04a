"""The paper's printed numbers, and the choices of settings that it does not print."""

from __future__ import annotations

import functools
import json
from collections.abc import Sequence
from importlib.resources import files
from typing import Any

from agents.algorithms import title
from agents.paper.presets import PAPER_SEEDS, ablations, preset, registered_id
from agents.reporting.tables import Printed
from agents.results.frame import hyperparameter_changes
from agents.results.reading import Group


def paper_results(task: str, title: str) -> dict[str, float]:
    """The paper's numbers for an algorithm on a task, by measure; empty where it prints none.

    title: of the algorithm, as the paper prints it.
    """
    name = registered_id(task)
    name = name.removesuffix("-v0") if name.startswith("Circle2D-") else name.split("/")[-1]
    return {
        measure: _as_meant(name, title, measure, values[title])
        for measure, values in _numbers()["results"].get(name, {}).items()
        if title in values
    }


@functools.cache
def _numbers() -> dict[str, Any]:
    return json.loads(files("agents.paper").joinpath("printed.json").read_text())


def _as_meant(task: str, title: str, measure: str, value: float) -> float:
    """The paper prints 4.68 here; no return of this task can be positive."""
    is_misprint = (task, title, measure) == ("Circle2D-1", "TRPO-Lag", "J_R")
    return -value if is_misprint else value


def printed(task: str, algorithm: str) -> Printed | None:
    """The paper's numbers for an algorithm on a task, as tables take them."""
    values = paper_results(task, title(algorithm))
    if not values:
        return None
    within = values["J_C"] <= preset(algorithm, task).cost_limit
    return Printed(values, within, f"paper ({PAPER_SEEDS} seeds)")


def choice_of(group: Group) -> str | None:
    """The name in `presets.ablations` of a group's hyper-parameters; empty where they are the
    preset's, None where they are others."""
    config = group.config
    for name, other in ablations(config.algorithm, group.task).items():
        if other == config.hyperparameters:
            return name
    return None if hyperparameter_changes(config, group.task) else ""


def split(groups: Sequence[Group]) -> tuple[list[Group], list[tuple[Group, Group]]]:
    """The groups to report as usual, and the pairs of a preset's group and an ablated one.

    Ablated is a group with another choice of what the paper does not print (`presets.ablations`)
    while nothing else differs from the preset, where the preset's group is there too; without it,
    it is a group like any other.
    """
    pairs = []
    for group in groups:
        if not choice_of(group):
            continue
        beside = [other for other in groups if _is_preset_of(other, group)]
        if beside:  # of several, such as published runs and a trial, that of most runs
            pairs.append((max(beside, key=lambda other: len(other.runs)), group))
    ablated = {id(group) for _, group in pairs}
    return [group for group in groups if id(group) not in ablated], pairs


def _is_preset_of(group: Group, ablated: Group) -> bool:
    """Whether a group is that of the preset, on equal terms with an ablated one."""
    names = ("algorithm", "task_parameters", "steps")
    equal = all(getattr(group.config, n) == getattr(ablated.config, n) for n in names)
    return equal and group.task == ablated.task and choice_of(group) == ""
