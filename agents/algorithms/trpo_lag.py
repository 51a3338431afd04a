"""TRPO-Lag: trust-region policy optimisation with a Lagrange multiplier on the episode cost.

Source: Ray, Achiam & Amodei 2019, "Benchmarking safe exploration in deep reinforcement learning";
in the paper's grid as "TRPO-Lag".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import torch
from torch import Tensor

from agents.algorithms import Algorithm
from agents.lockstep.lagrange import PROJECTED, Gain, Multiplier, MultiplierConfig
from agents.lockstep.streaks import StreakTailLimit
from agents.trust_region import Problem, Step, StepRule, TRPOConfig, TrustRegion


@dataclass(frozen=True)
class TRPOLagConfig(MultiplierConfig, StreakTailLimit, TRPOConfig):
    """Hyper-parameters of TRPO-Lag."""

    initial_multiplier: Annotated[float, Gain] = 0.001
    """Initial multiplier λ, at least 0. Paper: 0.001."""
    multiplier_lr: Annotated[float, Gain] = 0.005
    """Step size of the multiplier with adam or sgd. Paper: 0.005."""
    multiplier_optimizer: Literal["adam", "sgd", "pid"] = "adam"
    """How the multiplier follows the cost: it ascends by Adam or by the plain gradient (sgd), or a
    PID controller sets it (pid; Stooke et al. 2020). The choice decides how runs end. Not specified
    in the paper; adam is inferred from its Circle2D."""


def advantage(
    config: TRPOLagConfig, reward_advantage: Tensor, cost_advantage: Tensor, multipliers: Tensor
) -> Tensor:
    """`(A_r - λ A_c) / (1 + λ)`: the divisor keeps the scale as λ grows."""
    penalty = (multipliers[..., None] * cost_advantage).sum(dim=1)
    return (reward_advantage - penalty) / (1.0 + multipliers.sum(dim=1, keepdim=True))


def step(config: TRPOConfig, problem: Problem) -> Step:
    """TRPO's step: along the natural gradient to the boundary of the trust region."""
    runs = len(problem.excess)
    return Step(
        displacement=problem.to_boundary(problem.solve(problem.gradient)),
        must_improve=torch.ones(runs, dtype=torch.bool),
        cost_bound=torch.full((runs,), torch.inf),
        case=torch.ones(runs),
    )


RULE = StepRule(advantage, step, (Multiplier(PROJECTED),))
ALGORITHM = Algorithm("TRPO-Lag", TRPOLagConfig, RULE, TrustRegion, work=1.0)
