"""The algorithms: what each one's paper adds to its family. `ALGORITHMS` lists them by name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from agents.algorithms import cpo, sac_lag, sac_lb, trpo_lag, wcsac
from agents.errors import UserError, nearest
from agents.lockstep.noise import Epochs
from agents.lockstep.rollout import Act, Policy, Rollout
from agents.lockstep.tree import ALL
from agents.on_policy.learner import OnPolicy
from agents.sac.learner import OffPolicy


class Learner(Protocol):
    """The runs of one algorithm, as the training loop sees them: what a family provides.

    `policy`, `state` and `restore` are of the runs in a slice, by default of all.
    """

    episodes: int
    """Whole episodes of each run in an epoch."""
    metrics: tuple[str, ...]
    """Names of what `learn` returns."""

    def policy(self, runs: slice = ALL) -> Policy: ...
    def explorer(self, epoch: Epochs, steps: NDArray[np.int64]) -> Act: ...
    def learn(self, rollout: Rollout, epoch: Epochs, active: NDArray[np.bool_]) -> NDArray: ...
    def finite(self) -> NDArray[np.bool_]: ...
    def state_dict(self, runs: slice = ALL) -> dict[str, NDArray]: ...
    def load_state_dict(self, state: dict[str, NDArray], runs: slice = ALL) -> None: ...


class Algorithm(NamedTuple):
    """An algorithm: how it is written in tables, its hyper-parameters, its rule, its family."""

    title: str
    config: type
    rule: Any
    family: Callable[..., Learner]


ALGORITHMS: dict[str, Algorithm] = {
    "trpo-lag": Algorithm("TRPO-Lag", trpo_lag.TRPOLagConfig, trpo_lag.RULE, OnPolicy),
    "cpo": Algorithm("CPO", cpo.CPOConfig, cpo.RULE, OnPolicy),
    "sac-lag": Algorithm("SAC-Lag", sac_lag.SACLagConfig, sac_lag.RULE, OffPolicy),
    "sac-lb": Algorithm("SAC-LB", sac_lb.SACLBConfig, sac_lb.RULE, OffPolicy),
    "wcsac": Algorithm("WCSAC", wcsac.WCSACConfig, wcsac.RULE, OffPolicy),
}


def algorithm(name: str) -> Algorithm:
    """The algorithm of that name. Raises UserError, naming the valid ones, for another."""
    if name not in ALGORITHMS:
        raise UserError(f"unknown algorithm {name!r}: {nearest(name, ALGORITHMS)}")
    return ALGORITHMS[name]


def learner(
    name: str, config: Any, seeds: Sequence[int], observation_size: int, action_size: int
) -> Learner:
    """The runs of an algorithm, ready to be trained."""
    found = algorithm(name)
    return found.family(config, found.rule, seeds, observation_size, action_size)
