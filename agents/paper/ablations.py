"""Runs with the other choice of a setting that the paper does not print."""

from __future__ import annotations

from collections.abc import Sequence

from agents.paper.presets import ablations
from agents.paper.settings import hyperparameter_changes
from agents.results.reading import Group
from agents.training.config import TrainConfig


def choice_of(config: TrainConfig) -> str | None:
    """The name in `presets.ablations` of a configuration's hyper-parameters; empty where they are
    the preset's, None where they are others."""
    others = ablations(config.algorithm, config.task).items()
    found = (name for name, other in others if other == config.hyperparameters)
    return next(found, None if hyperparameter_changes(config) else "")


def split(groups: Sequence[Group]) -> tuple[list[Group], list[tuple[Group, Group]]]:
    """The groups to report as usual, and the pairs of a preset's group and an ablated one.

    Ablated is a group with another choice of what the paper does not print (`presets.ablations`)
    while nothing else differs from the preset, where the preset's group is there too; without it,
    it is a group like any other.
    """
    pairs = []
    for group in groups:
        if not choice_of(group.config):
            continue
        beside = [of for of in groups if _is_preset(of.config, group.config)]
        if beside:  # of several, such as published runs and a trial, that of most runs
            pairs.append((max(beside, key=lambda of: len(of.runs)), group))
    ablated = {group.folder for _, group in pairs}
    return [group for group in groups if group.folder not in ablated], pairs


def _is_preset(config: TrainConfig, ablated: TrainConfig) -> bool:
    """Whether it is that of the preset, on equal terms with an ablated one."""
    terms = [(c.algorithm, c.task, c.task_parameters, c.steps) for c in (config, ablated)]
    return terms[0] == terms[1] and choice_of(config) == ""
