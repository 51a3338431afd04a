"""PPO: proximal policy optimisation, without a constraint: a baseline for the others.

Source: Schulman et al. 2017, "Proximal policy optimization algorithms".
"""

from __future__ import annotations

from torch import Tensor

from agents.algorithms import Algorithm
from agents.first_order import FirstOrder, Objective, PPOConfig


def advantage(
    config: PPOConfig, reward_advantage: Tensor, cost_advantage: Tensor, multipliers: Tensor
) -> Tensor:
    """`A_r`: costs are recorded but not learned."""
    return reward_advantage


RULE = Objective(advantage, costs=0, limits=())
ALGORITHM = Algorithm("PPO", PPOConfig, RULE, FirstOrder, work=2.4)
