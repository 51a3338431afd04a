"""The algorithms: what each one's paper adds to its family. `ALGORITHMS` lists them by name."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from agents.algorithms import sac_lag
from agents.errors import UserError
from agents.updates.off_policy import OffPolicy
from agents.updates.sac import CostRule


class Algorithm(NamedTuple):
    """An algorithm: how it is written in tables, its hyper-parameters, its rule, its family."""

    title: str
    config: type
    rule: CostRule
    family: type = OffPolicy


ALGORITHMS: dict[str, Algorithm] = {
    "sac-lag": Algorithm("SAC-Lag", sac_lag.SACLagConfig, sac_lag.RULE),
}


def algorithm(name: str) -> Algorithm:
    """The algorithm of that name. Raises UserError, naming the valid ones, for another."""
    if name not in ALGORITHMS:
        raise UserError(f"unknown algorithm {name!r}: valid are {', '.join(ALGORITHMS)}")
    return ALGORITHMS[name]


def learner(
    name: str, config: Any, seeds: Sequence[int], observation_size: int, action_size: int
) -> OffPolicy:
    """The runs of an algorithm, ready to be trained."""
    found = algorithm(name)
    return found.family(config, found.rule, seeds, observation_size, action_size)
