"""PPO of Stable-Baselines3 with limits on the cost and on the longest streak of an episode.

`LongestStreak` makes the longest streak a cost; the multiplier of each cost follows its excess.
"""

import gymnasium as gym
import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv

import circle2d_mj  # noqa: F401  # registers the task
import emcc

LIMITS = np.array([5.0, 3.0])  # of an episode: its cost, and steps of its longest streak
multipliers = np.zeros(2)


class Penalised(gym.Wrapper):
    """Wrapper that subtracts the costs of a step, weighted by multipliers, from the reward."""

    def step(self, action):
        observation, reward, *ends, info = self.env.step(action)
        costs = np.array([info["cost"], info["record_cost"]])
        return observation, float(reward - multipliers @ costs), *ends, info


class Lagrangian(emcc.sb3.EMCCCallback):
    """Multipliers ascend on the excess of the last 20 episodes, and are never below 0."""

    def _on_rollout_end(self):
        super()._on_rollout_end()
        last = [self.episodes.cost[-20:], self.episodes.longest_streak[-20:]]
        multipliers[:] = np.maximum(multipliers + 0.02 * (np.mean(last, axis=1) - LIMITS), 0)


make = lambda: Penalised(emcc.LongestStreak(gym.make("Circle2D-1-v0")))  # noqa: E731
envs, callback = DummyVecEnv([make] * 4), Lagrangian(limit=LIMITS[0])
PPO("MlpPolicy", envs, n_steps=250, batch_size=250, seed=0, device="cpu").learn(6000, callback)
print(callback.panel().to_latex(), multipliers)
