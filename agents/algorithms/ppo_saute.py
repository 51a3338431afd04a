"""PPO-Sauté: PPO with observations augmented by the remaining cost budget of the episode.

Source: Sootla et al. 2022, "Sauté RL: almost surely safe reinforcement learning using state
augmentation", with the budget of OmniSafe's adapter.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from agents.algorithms import Algorithm
from agents.algorithms.ppo import advantage  # of the reward that `relabelled` returns
from agents.checks import In
from agents.errors import UserError
from agents.first_order import FirstOrder, Objective, PPOConfig
from agents.lockstep.rollout import Rollout
from agents.on_policy.state import EpisodeCostLimit
from emcc.augmented import Augmentation, Bounds, Numbers, augmented


@dataclass(frozen=True)
class Budget(Augmentation):
    """Remaining share z of an episode's budget: 1 before the first step; a step of cost c changes z
    to `(z - c / budget) / discount`."""

    budget: float
    discount: float
    cost: str
    start = (1.0,)
    strict = False  # `collect` marks episodes with invalid costs as failed

    @property
    def bounds(self) -> Bounds:
        """Bounds of z."""
        return ((-np.inf, np.inf),)

    def after(self, state: Numbers, cost: Numbers) -> tuple[Numbers, dict[str, Numbers]]:
        """Return the remaining share of the budget after costs."""
        spent = np.where(np.isfinite(cost), cost, 0.0) / self.budget
        return (state - spent[:, None]) / self.discount, {}

    def shown(self, state: Numbers) -> Numbers:
        """Return z unchanged."""
        return state


@dataclass(frozen=True)
class SauteConfig(EpisodeCostLimit):
    """Hyper-parameters of Sauté's state and reward."""

    unsafe_reward: Annotated[float, In(-1e9, 1e9)] = -1.0
    """Learned reward of each step after which the budget is spent; records keep the task's reward.
    -1 as in OmniSafe, which has -0.2 on velocity tasks."""
    saute_discount: Annotated[float, In(above=0, high=1)] = 0.999
    """Discount γ of costs in the budget. The budget of an episode's discounted cost is
    `d (1 - γ^T) / ((1 - γ) T)`, d being `cost_limit` and T steps the task's time limit; with γ = 1
    it is d. 0.999 as in OmniSafe, which has 0.9999 on velocity tasks."""

    def __post_init__(self) -> None:
        """Check the values. Raises UserError naming one that is not allowed."""
        super().__post_init__()
        if self.cost_limit == 0:
            raise UserError("cost_limit must be above 0 with Sauté: the state is a share of it")
        if self.streak_weight:
            raise UserError(f"streak_weight must be 0 with Sauté, got {self.streak_weight}")

    def budget(self, time_limit: int | None) -> float:
        """Return the budget of an episode's discounted cost. Raises UserError if the budget depends
        on a time limit and there is none."""
        gamma = self.saute_discount
        if gamma == 1:
            return self.cost_limit
        if time_limit is None:
            raise UserError(
                f"saute_discount {gamma:g} needs a task with a time limit, which the budget "
                "depends on; saute_discount 1 takes any task"
            )
        return self.cost_limit * (1 - gamma**time_limit) / (1 - gamma) / time_limit

    def wrap(self, env: Any, costs: tuple[str, ...], time_limit: int | None) -> Any:
        """Return the environment with z at the end of its observations."""
        return augmented(env, Budget(self.budget(time_limit), self.saute_discount, costs[0]))

    def relabelled(self, rollout: Rollout) -> Rollout:
        """Return the rollout with `unsafe_reward` for steps that leave no budget, `z ≤ 0`."""
        spent = rollout.next_observation[..., -1] <= 1e-6  # 0 but for rounding
        return rollout._replace(reward=np.where(spent, self.unsafe_reward, rollout.reward))


@dataclass(frozen=True)
class PPOSauteConfig(SauteConfig, PPOConfig):
    """Hyper-parameters of PPO-Sauté."""


RULE = Objective(advantage, costs=0)  # what costs change is in the state and the reward
ALGORITHM = Algorithm("PPO-Sauté", PPOSauteConfig, RULE, FirstOrder, work=2.4)
