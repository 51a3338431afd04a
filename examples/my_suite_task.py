"""A custom task from Safety-Gymnasium's parts: a car among hazards and circling gremlins.

python examples/my_suite_task.py
circle2d train ppo-lag --import my_suite_task --task SafetyCarGauntlet-v0 --out runs/gauntlet
"""

import gymnasium as gym
import numpy as np

from circle2d_mj.safety import own
from circle2d_mj.safety.families import GoalTask


class Hurry(GoalTask):
    """Goal task whose reward is the progress towards the goal minus 0.001 for every step."""

    def _reward(self, before, after, met):
        return super()._reward(before, after, met) - 0.001


own.register(
    "SafetyCarGauntlet-v0",
    Hurry,
    {"hazards": 5, "gremlins": 2},
    agent="Car",
    costs=("hazards", "gremlins"),
    half_width=1.6,
    max_episode_steps=400,
)

if __name__ == "__main__":
    envs = gym.make_vec("SafetyCarGauntlet-v0", num_envs=8, layout_seed=7)  # one layout for all
    observation, info = envs.reset(seed=0)
    costs = np.zeros(8)
    for _ in range(400):
        observation, reward, _, _, info = envs.step(envs.action_space.sample())
        costs += info["cost"]
    print(f"{observation.shape[1]} numbers are observed; episodes cost {costs.mean():g}")
