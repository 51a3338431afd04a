"""SAC-Lag: soft actor-critic with a Lagrange multiplier on the expected cost.

Source: Ha et al. 2020, "Learning to walk in the real world with minimal human effort"; in the
paper's grid as "SAC-Lag".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from agents.algorithms import Algorithm
from agents.lockstep.kernel import Float
from agents.lockstep.lagrange import SOFTPLUS, Multiplier
from agents.lockstep.pulled import Pull, closed_form
from agents.lockstep.streaks import StreakTailLimit
from agents.sac import CostRule, MultiplierOfConfig, OffPolicy, SACConfig
from agents.sac.replay import Batch
from agents.sac.update import mean, shares


@dataclass(frozen=True)
class SACLagConfig(StreakTailLimit, MultiplierOfConfig):
    """Hyper-parameters of SAC-Lag.

    The multiplier is β = softplus(parameter), at first 0.69: the parameter starts at 0.
    """

    cost_estimate: Literal["larger", "mean"] = "larger"
    """Estimate of a cost by its two critics: the larger value (larger; as in the paper), also in
    both critics' targets; or the mean (mean), each critic with a target of its own, in which the
    next value is at least 0. The larger one may far exceed the true cost. Not in the paper."""


def risk(config: SACConfig, cost_values: Tensor) -> Tensor:
    """The larger of the two cost critics' values, so that errors are on the side of caution, or
    their mean: see `SACLagConfig.cost_estimate`."""
    if config.cost_estimate == "mean":
        return cost_values.mean(dim=1)
    return torch.maximum(cost_values[:, 0], cost_values[:, 1])


@closed_form(risk)
def _risk(config: SACConfig, cost_values: Float) -> tuple[Float, Pull]:
    if config.cost_estimate == "mean":
        half = np.full_like(cost_values, 0.5)
        return cost_values.mean(axis=1), lambda slope: slope[:, None] * half
    share = shares(cost_values, -1.0)
    return np.maximum(cost_values[:, 0], cost_values[:, 1]), lambda slope: slope[:, None] * share


def critic_loss(
    config: SACConfig, cost_values: Tensor, next_cost_values: Tensor, batch: Batch
) -> Tensor:
    """Half the mean squared error of each critic against `c + γ max Q_c'`, summed over both; with
    the mean as estimate, against its own `c + γ max(0, Q_c')`."""
    if config.cost_estimate == "mean":
        following = next_cost_values.clamp(min=0.0)
    else:
        following = risk(config, next_cost_values)[:, None]
    discount = config.discount * (1.0 - batch.cost_terminal)
    error = cost_values - (batch.cost[:, None] + discount[:, None] * following)
    return 0.5 * (error * error).mean(dim=-1).sum(dim=-1)


@closed_form(critic_loss)
def _critic_loss(
    config: SACConfig, cost_values: Float, next_cost_values: Float, batch: Batch
) -> tuple[Float, Pull]:
    discount = config.discount * (1.0 - batch.cost_terminal)
    if config.cost_estimate == "mean":
        following = np.maximum(next_cost_values, 0.0)
    else:
        following = np.maximum(next_cost_values[:, :1], next_cost_values[:, 1:])
    return squared(cost_values - (batch.cost[:, None] + discount[:, None] * following))


def squared(error: Float) -> tuple[Float, Pull]:
    """Half the mean square over B of errors [R, K, B], summed over K, and its `Pull`."""
    pull = lambda slope: slope[:, None, None] * error / error.shape[-1]  # noqa: E731
    return 0.5 * mean(error * error).sum(axis=-1), pull


def penalty(config: SACLagConfig, risk: Tensor, multipliers: Tensor) -> Tensor:
    """`β Q_c`: the constraint's term of the Lagrangian (its constant, -β d, has no gradient)."""
    return multipliers[..., None] * risk


@closed_form(penalty)
def _penalty(config: SACLagConfig, risk: Float, multipliers: Float) -> tuple[Float, Pull]:
    return multipliers[..., None] * risk, lambda slope: multipliers[..., None] * slope


RULE = CostRule(risk, critic_loss, penalty, (Multiplier(SOFTPLUS),))
ALGORITHM = Algorithm("SAC-Lag", SACLagConfig, RULE, OffPolicy, work=5.0)
