"""CRPO: constraint-rectified policy optimisation: a step for the reward, or one against the cost.

Source: Xu, Liang & Lan 2021, "CRPO: a new approach for safe reinforcement learning with convergence
guarantee", algorithm 1, with the steps of TRPO as in its experiments.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import torch
from torch import Tensor

from agents.algorithms import Algorithm
from agents.algorithms.trpo_lag import step
from agents.checks import In
from agents.lockstep.lagrange import PROJECTED, Multiplier
from agents.trust_region import StepRule, TRPOConfig, TrustRegion


@dataclass(frozen=True)
class CRPOConfig(TRPOConfig):
    """Hyper-parameters of CRPO. The recorded multiplier is 1 in epochs that step against cost."""

    tolerance: Annotated[float, In(0, 1e9)] = 0.5
    """Tolerance η: by how much the cost of an episode may exceed the limit in an epoch that steps
    for the reward. Our choice; OmniSafe: 2."""


def rectifies(config: CRPOConfig, before: Tensor, cost: Tensor) -> Tensor:
    """Return 1 where `J_C > d + η`, else 0; cost: [R, 1]."""
    return (cost > config.cost_limit + config.tolerance).to(before.dtype)


def advantage(
    config: CRPOConfig, reward_advantage: Tensor, cost_advantage: Tensor, multipliers: Tensor
) -> Tensor:
    """`A_r`, or `-A_c` in an epoch that steps against the cost."""
    return torch.where(multipliers > 0, -cost_advantage[:, 0], reward_advantage)


SWITCH = Multiplier(PROJECTED._replace(law=rectifies), ahead=True)
RULE = StepRule(advantage, step, (SWITCH,))
ALGORITHM = Algorithm("CRPO", CRPOConfig, RULE, TrustRegion, work=1.0)
