"""P3O: penalised proximal policy optimisation, with an exact penalty that is clipped like PPO's.

Source: Zhang et al. 2022, "Penalized proximal policy optimization for safe reinforcement learning",
equation 10 and algorithm 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import torch
from torch import Tensor

from agents.algorithms import Algorithm
from agents.algorithms.ppo import advantage  # of reward alone: costs enter in the penalty
from agents.checks import In
from agents.first_order import FirstOrder, Minibatch, Objective, PPOConfig, clipped, mean
from agents.on_policy.state import EpisodeCostLimit, Gaussian


@dataclass(frozen=True)
class P3OConfig(EpisodeCostLimit, PPOConfig):
    """Hyper-parameters of P3O."""

    discount: Annotated[float, In(0, 0.999999)] = 0.99
    """Discount factor γ of rewards and costs, below 1: the penalty weighs J_C - d by 1 - γ. 0.99 as
    in OmniSafe."""
    penalty_factor: Annotated[float, In(0, 1e6)] = 20.0
    """Factor κ of the penalty. 20 as in OmniSafe."""
    kl_stop: Annotated[float, In(0, 1e12)] = 0.02
    """Mean KL divergence beyond which an epoch's passes of the actor end; 0: never. 0.02 as in
    OmniSafe."""
    max_gradient_norm: Annotated[float, In(above=0, high=1e12)] = 40.0
    """Norm to which the actor's gradient is clipped. 40 as in OmniSafe."""


def surrogate(
    config: P3OConfig, policy: Gaussian, ratio: Tensor, batch: Minibatch
) -> tuple[Tensor, Tensor]:
    """`E[min(ρ A_r, clip(ρ) A_r)] - κ max(0, E[max(ρ A_c, clip(ρ) A_c)] + (1 - γ) (J_C - d))`."""
    raised, outside = clipped(config, policy, ratio, batch)
    cost = batch.cost_advantage[:, 0]
    bounded = ratio.clamp(1.0 - config.clip_range, 1.0 + config.clip_range)
    growth = mean(batch, torch.maximum(ratio * cost, bounded * cost))
    predicted = growth + (1.0 - config.discount) * batch.excess[:, 0]
    return raised - config.penalty_factor * predicted.clamp(min=0.0), outside


RULE = Objective(advantage, surrogates=(surrogate,))
ALGORITHM = Algorithm("P3O", P3OConfig, RULE, FirstOrder, work=2.4)
