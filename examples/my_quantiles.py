"""SAC-Quantile: SAC-Lag that limits the mean of the worst quarter of cost returns, predicted by a
cost critic whose outputs are quantiles, as in QR-DQN (Dabney et al. 2018)."""

from dataclasses import dataclass
from typing import Annotated

import torch

import agents
from agents.algorithms.sac_lag import SACLagConfig, penalty
from agents.checks import In
from agents.lockstep.lagrange import SOFTPLUS, Multiplier
from agents.sac import CostRule, OffPolicy


@dataclass(frozen=True)
class SACQuantileConfig(SACLagConfig):
    """Hyper-parameters of SAC-Quantile."""

    cost_critics: Annotated[int, In(4, 200)] = 16
    """Number N of quantiles of the cost return; each is a network with one output."""


def risk(config, values):
    """Return the mean of the greatest quarter of the quantiles: values [R, N, B] -> [R, B]."""
    return values.topk(config.cost_critics // 4, dim=1).values.mean(dim=1)


def critic_loss(config, values, next_values, batch):
    """Return the quantile Huber loss of each output against all targets: [R]."""
    count, rest = config.cost_critics, config.discount * (1.0 - batch.cost_terminal)
    target = batch.cost[:, None] + rest[:, None] * next_values  # [R, N, B]
    error = target[:, None] - values[:, :, None]  # [R, N outputs, N targets, B]
    huber = torch.where(error.abs() < 1.0, 0.5 * error * error, error.abs() - 0.5)
    share = (torch.arange(count, device=error.device)[:, None, None] + 0.5) / count
    weight = (share - (error.detach() < 0).to(error.dtype)).abs()
    return (weight * huber).mean(dim=(2, 3)).sum(dim=1)


rule = CostRule(risk, critic_loss, penalty, (Multiplier(SOFTPLUS),))
algorithm = agents.Algorithm("SAC-Quantile", SACQuantileConfig, rule, OffPolicy)
agents.register("sac-quantile", algorithm)
