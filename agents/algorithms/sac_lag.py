"""SAC-Lag: soft actor-critic with a Lagrange multiplier on the expected cost.

Source: Ha et al. 2020, "Learning to walk in the real world with minimal human effort"; in the
paper's grid as "SAC-Lag".
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import softplus

from agents.lockstep.replay import Batch
from agents.updates.sac import CostRule, Multiplier, MultiplierConfig


@dataclass(frozen=True)
class SACLagConfig(MultiplierConfig):
    """Hyper-parameters of SAC-Lag.

    The parameter 0 that the multiplier starts from makes it softplus(0) = 0.69.
    """


def risk(config: SACLagConfig, costs: Tensor) -> Tensor:
    """The larger of both cost critics: errors then err on the side of caution."""
    return torch.maximum(costs[:, 0], costs[:, 1])


def critic_loss(config: SACLagConfig, costs: Tensor, next_costs: Tensor, batch: Batch) -> Tensor:
    """Half the mean squared error of each critic against `c + γ max Q_c'`, summed over both."""
    target = batch.cost + config.discount * (1.0 - batch.terminal) * risk(config, next_costs)
    error = costs - target[:, None]
    return 0.5 * (error * error).mean(dim=-1).sum(dim=-1)


def penalty(config: SACLagConfig, risk: Tensor, multiplier: Tensor) -> Tensor:
    """`β Q_c`: the constraint's term of the Lagrangian (its constant, -β d, has no gradient)."""
    return multiplier * risk


def multiplier_gradient(config: SACLagConfig, parameter: Tensor, risk: Tensor) -> Tensor:
    """Of `-β E[Q_c - d]` with `β = softplus(parameter)`: β rises where the cost is too high."""
    excess = risk.mean(dim=-1, keepdim=True) - config.cost_limit
    return -torch.sigmoid(parameter) * excess


RULE = CostRule(risk, critic_loss, penalty, Multiplier(softplus, multiplier_gradient))
