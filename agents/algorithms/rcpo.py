"""RCPO: reward-constrained policy optimisation: natural gradients of a penalised reward.

Source: Tessler, Mankowitz & Mannor 2019, "Reward constrained policy optimization", algorithm 1,
with the natural gradient as its actor's step, as in OmniSafe.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import torch

from agents.algorithms import Algorithm, trpo_lag
from agents.checks import In
from agents.lockstep.lagrange import PROJECTED, Gain, Multiplier
from agents.trust_region import Problem, Step, StepRule, TrustRegion


@dataclass(frozen=True)
class RCPOConfig(trpo_lag.TRPOLagConfig):
    """Hyper-parameters of RCPO."""

    multiplier_lr: Annotated[float, Gain] = 0.035
    """Step size of the multiplier with adam or sgd. 0.035 as in OmniSafe."""
    line_search_steps: Annotated[int, In(1, 10_000)] = 15
    """Without effect: RCPO has no line search."""
    line_search_decay: Annotated[float, In(above=0, high=1)] = 0.8
    """Without effect: RCPO has no line search."""


def step(config: RCPOConfig, problem: Problem) -> Step:
    """Natural-gradient step of full length, `½ xᵀHx = δ`, without a line search."""
    plain = trpo_lag.step(config, problem)
    anywhere = torch.zeros_like(plain.must_improve)
    return plain._replace(must_improve=anywhere, divergence=lambda kl, growth: 0.0 * growth)


# The penalised reward r - λc has the advantage A_r - λ A_c, here divided by 1 + λ.
RULE = StepRule(trpo_lag.advantage, step, (Multiplier(PROJECTED, ahead=True),))
ALGORITHM = Algorithm("RCPO", RCPOConfig, RULE, TrustRegion, work=1.0)
