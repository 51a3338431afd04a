"""CAL: conservative augmented Lagrangian, soft actor-critic with an ensemble of cost critics.

Source: Wu et al. 2024, "Off-policy primal-dual safe reinforcement learning", equations 5 to 9, and
the authors' code.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
import torch
from torch import Tensor

from agents.algorithms import Algorithm
from agents.algorithms.sac_lag import penalty, squared
from agents.checks import In
from agents.lockstep.kernel import Float
from agents.lockstep.lagrange import EXP, Multiplier
from agents.lockstep.pulled import Pull, closed_form
from agents.sac import CostRule, MultiplierOfConfig, OffPolicy
from agents.sac.replay import Batch


@dataclass(frozen=True)
class CALConfig(MultiplierOfConfig):
    """Hyper-parameters of CAL. The multiplier is λ = exp(parameter)."""

    multiplier_of: Literal["replay", "start"] = "replay"
    """Cost that the multiplier and the quadratic penalty follow: the upper bound of the cost at
    the states of the replay (replay; as Wu et al.), or at start states of the last 64 episodes
    (start). Episode costs have no such bound."""
    initial_multiplier: Annotated[float, In(-50, 50)] = math.log(0.6931)
    """Initial parameter of the multiplier, before it is mapped to positive numbers. Wu et al.:
    log(0.6931)."""
    cost_critics: Annotated[int, In(2, 1_000)] = 4
    """Cost critics of the ensemble. Wu et al.: 4, on MuJoCo 8."""
    conservatism: Annotated[float, In(0, 1e6)] = 0.5
    """Number k of the ensemble's standard deviations that are added to its mean. Wu et al.: 0.5."""
    convexity: Annotated[float, In(0, 1e6)] = 10.0
    """Factor c of the quadratic penalty. Wu et al.: 10, on Ant 100."""


def risk(config: CALConfig, cost_values: Tensor) -> Tensor:
    """`mean Q_c + k std Q_c` over the ensemble: an upper confidence bound of the cost."""
    std, mean = torch.std_mean(cost_values, dim=1)
    return mean + config.conservatism * std


@closed_form(risk)
def _risk(config: CALConfig, cost_values: Float) -> tuple[Float, Pull]:
    count, mean = cost_values.shape[1], cost_values.mean(axis=1)
    off = cost_values - mean[:, None]
    std = np.sqrt((off * off).sum(axis=1) / (count - 1))
    share = off / (np.where(std > 0, std, 1.0) * (count - 1))[:, None]  # 0 where all are equal
    share = 1.0 / count + config.conservatism * share
    return mean + config.conservatism * std, lambda slope: slope[:, None] * share


def critic_loss(
    config: CALConfig, cost_values: Tensor, next_cost_values: Tensor, batch: Batch
) -> Tensor:
    """Half the mean squared error of each critic against its target network's `c + γ Q_c'`."""
    discount = config.discount * (1.0 - batch.cost_terminal)
    target = batch.cost[:, None] + discount[:, None] * next_cost_values
    error = cost_values - target
    return 0.5 * (error * error).mean(dim=-1).sum(dim=-1)


@closed_form(critic_loss)
def _critic_loss(
    config: CALConfig, cost_values: Float, next_cost_values: Float, batch: Batch
) -> tuple[Float, Pull]:
    discount = config.discount * (1.0 - batch.cost_terminal)
    return squared(cost_values - batch.cost[:, None] - discount[:, None] * next_cost_values)


def augmented(config: CALConfig, multipliers: Tensor, risk: Tensor) -> Tensor:
    """`max(0, λ - c (d - E[risk]))`: slope of the augmented Lagrangian; risk: `E[risk]`, [R, C]."""
    return (multipliers - config.convexity * (config.cost_limit - risk)).clamp(min=0.0)


RULE = CostRule(risk, critic_loss, penalty, (Multiplier(EXP),), augmented=augmented)
ALGORITHM = Algorithm("CAL", CALConfig, RULE, OffPolicy, work=7.0)
