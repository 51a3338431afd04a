"""CUP: constrained update projection.

Source: Yang et al. 2022, "Constrained update projection approach to safe policy optimization",
algorithm 1; its hyper-parameters are those of the authors' code.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import torch
from torch import Tensor

from agents.algorithms import Algorithm
from agents.algorithms.ppo import advantage  # of reward alone: costs enter in the projection
from agents.checks import In
from agents.first_order import FirstOrder, Minibatch, Objective, PPOConfig, clipped, mean
from agents.lockstep.lagrange import PROJECTED, Gain, Multiplier, MultiplierConfig
from agents.on_policy.state import EpisodeCostLimit, Gaussian


@dataclass(frozen=True)
class CUPConfig(MultiplierConfig, EpisodeCostLimit, PPOConfig):
    """Hyper-parameters of CUP. The multiplier is ν."""

    kl_stop: Annotated[float, In(0, 1e12)] = 0.02
    """Mean KL divergence from a step's start beyond which the passes of that step end; 0: never.
    Yang et al.: 0.02, in the projection from the start of both steps."""
    multiplier_optimizer: Literal["adam", "sgd", "pid"] = "sgd"
    """How the multiplier follows the cost. Yang et al.: by the plain gradient (sgd)."""
    multiplier_lr: Annotated[float, Gain] = 0.01
    """Step size of the multiplier by adam or sgd. Yang et al.: 0.01."""
    max_multiplier: Annotated[float, Gain] = 2.0
    """Largest multiplier by adam or sgd. Yang et al.: 2."""
    max_gradient_norm: Annotated[float, In(above=0, high=1e12)] = 40.0
    """Norm to which a longer gradient of the actor is scaled. Yang et al.: 40."""
    initial_log_std: Annotated[float, In(-20, 20)] = -0.5
    """Initial logarithm of the policy's standard deviation. Yang et al.: -0.5."""


def projection(
    config: CUPConfig, policy: Gaussian, ratio: Tensor, batch: Minibatch
) -> tuple[Tensor, Tensor]:
    """`-E[KL(π ‖ π_{k+½}) + ν (1 - γλ)/(1 - γ) ρ A_c]`: back to few costs, near the first step's
    policy. No step is left out."""
    scale = (1.0 - config.discount * config.gae_lambda) / (1.0 - config.discount)
    cost = (batch.multipliers[..., None] * batch.cost_advantage).sum(dim=1)
    loss = policy.kl(batch.start) + scale * ratio * cost
    return -mean(batch, loss), torch.zeros_like(loss[:, 0])


MULTIPLIER = Multiplier(PROJECTED, highest="max_multiplier", ahead=True)
RULE = Objective(advantage, (MULTIPLIER,), surrogates=(clipped, projection))
ALGORITHM = Algorithm("CUP", CUPConfig, RULE, FirstOrder)
