"""RCPO: reward-constrained policy optimisation: natural gradients of a penalised reward.

Source: Tessler, Mankowitz & Mannor 2019, "Reward constrained policy optimization", algorithm 1,
with the natural gradient as its actor's step, as in OmniSafe.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import torch

from agents.algorithms import Algorithm, trpo_lag
from agents.lockstep.lagrange import PROJECTED, Gain, Multiplier
from agents.trust_region import Problem, Step, StepRule, TrustRegion


@dataclass(frozen=True)
class RCPOConfig(trpo_lag.TRPOLagConfig):
    """Hyper-parameters of RCPO."""

    multiplier_lr: Annotated[float, Gain] = 0.035
    """Step size of the multiplier by adam or sgd. 0.035 as in OmniSafe."""


def step(config: RCPOConfig, problem: Problem) -> Step:
    """The natural gradient at its whole length, `½ xᵀHx = δ`: there is no line search."""
    plain = trpo_lag.step(config, problem)
    anywhere = torch.zeros_like(plain.must_improve)
    return plain._replace(must_improve=anywhere, divergence=lambda kl, growth: 0.0 * growth)


# Of the penalised reward r - λc the advantage is A_r - λ A_c, here over 1 + λ.
RULE = StepRule(trpo_lag.advantage, step, (Multiplier(PROJECTED, ahead=True),))
ALGORITHM = Algorithm("RCPO", RCPOConfig, RULE, TrustRegion, work=1.0)
