"""CUP: constrained update projection.

Source: Yang et al. 2022, "Constrained update projection approach to safe policy optimization",
algorithm 1, and the authors' code, which the hyper-parameters are from.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import torch
from torch import Tensor

from agents.algorithms import Algorithm
from agents.algorithms.focops import MULTIPLIER, ProjectedMultiplierConfig
from agents.algorithms.ppo import advantage  # of reward alone: costs enter in the projection
from agents.checks import In
from agents.first_order import FirstOrder, Minibatch, Objective, PPOConfig, clipped, mean
from agents.on_policy.state import Gaussian


@dataclass(frozen=True)
class CUPConfig(ProjectedMultiplierConfig, PPOConfig):
    """Hyper-parameters of CUP. The multiplier is ν."""

    discount: Annotated[float, In(0, 0.999999)] = 0.99
    """Discount factor γ of rewards and costs, below 1: the projection divides by 1 - γ. Paper:
    0.99."""


def projection(
    config: CUPConfig, policy: Gaussian, ratio: Tensor, batch: Minibatch
) -> tuple[Tensor, Tensor]:
    """`-E[KL(π ‖ π_{k+½}) + ν (1 - γλ)/(1 - γ) ρ A_c]`: lower costs near the policy π_{k+½} of the
    first surrogate. No environment step is left out: the share is 0."""
    scale = (1.0 - config.discount * config.gae_lambda) / (1.0 - config.discount)
    cost = (batch.multipliers[..., None] * batch.cost_advantage).sum(dim=1)
    loss = policy.kl(batch.start) + scale * ratio * cost
    return -mean(batch, loss), torch.zeros_like(loss[:, 0])


RULE = Objective(advantage, (MULTIPLIER,), surrogates=(clipped, projection), reverse_kl=True)
ALGORITHM = Algorithm("CUP", CUPConfig, RULE, FirstOrder, work=3.5)
