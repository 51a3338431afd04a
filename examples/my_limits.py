"""PPO-Two: PPO-Lag with a limit on each of two costs, and a task with two costs."""

from dataclasses import dataclass

import gymnasium as gym

import agents
from agents.algorithms.ppo_lag import PPOLagConfig, advantage
from agents.first_order import FirstOrder, Objective
from agents.lockstep.lagrange import PROJECTED, Multiplier


@dataclass(frozen=True)
class PPOTwoConfig(PPOLagConfig):
    """Hyper-parameters of PPO-Two."""

    second_limit: float = 10.0
    """Limit of the second cost of an episode."""


first, second = Multiplier(PROJECTED), Multiplier(PROJECTED, signal=1, limit="second_limit")
rule = Objective(advantage, (first, second), costs=2)
agents.register("ppo-two", agents.Algorithm("PPO-Two", PPOTwoConfig, rule, FirstOrder))


class Hasty(gym.Wrapper):
    """Circle2D-1 with a second cost, for large moves."""

    def step(self, action):
        *result, info = self.env.step(action)
        return *result, info | {"cost_2": float(abs(action).max() > 0.9)}


gym.register("Hasty-v0", lambda: Hasty(gym.make("Circle2D-1-v0")), max_episode_steps=50)
