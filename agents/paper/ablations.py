"""Runs with the other choice of a setting that the paper does not print."""

from __future__ import annotations

from collections.abc import Sequence

from agents.algorithms import ALGORITHMS
from agents.paper.presets import ablations, preset
from agents.results.reading import Group
from agents.training.config import TrainConfig


def split(groups: Sequence[Group]) -> tuple[list[Group], list[tuple[Group, Group]]]:
    """The groups to report as usual, and the pairs of a preset's group and an ablated one.

    Ablated is a group with another choice of what the paper does not print (`presets.ablations`)
    while nothing else differs from the preset, where the preset's group is there too; without it,
    it is a group like any other.
    """
    pairs = []
    for group in groups:
        beside = [other for other in groups if _is_ablation(group.config, other.config)]
        pairs += [(beside[0], group)] if beside else []
    ablated = {group.folder for _, group in pairs}
    return [group for group in groups if group.folder not in ablated], pairs


def _is_ablation(config: TrainConfig, of: TrainConfig) -> bool:
    """Whether it is that of a preset but for the choice of what is not printed, on equal terms."""
    if config.algorithm not in ALGORITHMS:
        return False
    if config.hyperparameters not in ablations(config.algorithm, config.task).values():
        return False
    if of.algorithm != config.algorithm or of.hyperparameters != preset(of.algorithm, of.task):
        return False
    terms = [(c.task, c.task_parameters, c.steps) for c in (config, of)]
    return terms[0] == terms[1]
