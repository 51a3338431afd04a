"""FOCOPS: first-order constrained optimisation in policy space.

Source: Zhang, Vuong & Ross 2020, "First order constrained optimization in policy space", algorithm
1 and appendix, and the authors' code, which the hyper-parameters are from.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import torch
from torch import Tensor

from agents.algorithms import Algorithm
from agents.checks import In
from agents.first_order import FirstOrder, FirstOrderConfig, Minibatch, Objective, mean
from agents.lockstep.lagrange import PROJECTED, Gain, Multiplier, MultiplierConfig
from agents.lockstep.streaks import StreakTailLimit
from agents.on_policy.state import EpisodeCostLimit, Gaussian


@dataclass(frozen=True)
class ProjectedMultiplierConfig(
    MultiplierConfig, StreakTailLimit, EpisodeCostLimit, FirstOrderConfig
):
    """Hyper-parameters that FOCOPS and CUP share, equal in both papers' code."""

    limit_of: Literal["discounted", "episode"] = "episode"
    """Which cost `cost_limit` limits: the discounted cost of an episode, which the multiplier
    follows (discounted; as in both papers' code), or its undiscounted cost, as in the other
    on-policy algorithms (episode). With episode, the limit of the discounted cost is
    `d (1 - γ^T) / ((1 - γ) T)`, T steps being the task's time limit."""
    standardize_cost_advantages: bool = True
    """Whether cost advantages are divided by their standard deviation in an epoch. Zhang et al. and
    Yang et al.: yes."""
    kl_stop: Annotated[float, In(0, 1e12)] = 0.02
    """Mean KL divergence `KL(π ‖ π_k)` beyond which an epoch's passes of the actor end, π_k being
    the policy that took the steps; 0: never. Zhang et al. and Yang et al.: 0.02."""
    multiplier_optimizer: Literal["adam", "sgd", "pid"] = "sgd"
    """How the multiplier follows the cost. Zhang et al. and Yang et al.: by the plain gradient
    (sgd)."""
    multiplier_lr: Annotated[float, Gain] = 0.01
    """Step size of the multiplier with adam or sgd. Zhang et al. and Yang et al.: 0.01."""
    max_multiplier: Annotated[float, Gain] = 2.0
    """Largest multiplier ν_max with adam or sgd. Zhang et al. and Yang et al.: 2."""
    max_gradient_norm: Annotated[float, In(above=0, high=1e12)] = 40.0
    """Norm to which the actor's gradient is clipped. Zhang et al. and Yang et al.: 40."""
    initial_log_std: Annotated[float, In(-20, 20)] = -0.5
    """Initial logarithm of the policy's standard deviation. Zhang et al. and Yang et al.: -0.5."""

    @property
    def limited_cost(self) -> str:
        """The limited cost in words, for tables."""
        converted = ", its limit converted from that of the undiscounted cost"
        return "discounted cost of an episode" + converted * (self.limit_of == "episode")


@dataclass(frozen=True)
class FOCOPSConfig(ProjectedMultiplierConfig):
    """Hyper-parameters of FOCOPS. The multiplier is ν."""

    temperature: Annotated[float, In(above=0, high=1e6)] = 1.5
    """Temperature λ: the lower it is, the further the optimal policy is from the old one. Zhang et
    al.: 1.5."""
    kl_bound: Annotated[float, In(above=0, high=1e6)] = 0.02
    """KL divergence δ from the old policy beyond which a state is left out of the objective. Zhang
    et al.: 0.02."""


def advantage(
    config: FOCOPSConfig, reward_advantage: Tensor, cost_advantage: Tensor, multipliers: Tensor
) -> Tensor:
    """`A_r - ν A_c`."""
    return reward_advantage - (multipliers[..., None] * cost_advantage).sum(dim=1)


def surrogate(
    config: FOCOPSConfig, policy: Gaussian, ratio: Tensor, batch: Minibatch
) -> tuple[Tensor, Tensor]:
    """`E[1{KL ≤ δ} (ρ A / λ - KL)]`, `KL = KL(π ‖ π_k)` at a state."""
    kl = policy.kl(batch.start)
    near = (kl.detach() <= config.kl_bound).to(kl.dtype)
    gain = near * (ratio * batch.advantage / config.temperature - kl)
    return mean(batch, gain), mean(batch, torch.ones_like(near) - near)


MULTIPLIER = Multiplier(PROJECTED, highest="max_multiplier", ahead=True, discounted=True)
RULE = Objective(advantage, (MULTIPLIER,), surrogates=(surrogate,), reverse_kl=True)
ALGORITHM = Algorithm("FOCOPS", FOCOPSConfig, RULE, FirstOrder, work=2.4)
