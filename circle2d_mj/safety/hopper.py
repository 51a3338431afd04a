"""SafetyHopperVelocity-v1: gymnasium's Hopper with a speed limit."""

from __future__ import annotations

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from circle2d_mj.core.simulation import Outcome
from circle2d_mj.core.streams import Streams
from circle2d_mj.safety import models, rules
from circle2d_mj.safety.mujoco_task import MuJoCoTask
from circle2d_mj.safety.views import HopperView

SUBSTEPS = 4
START_NOISE = 0.005


class SafetyHopperVelocity(MuJoCoTask):
    """`num_envs` copies of the task. Steps of 0.008 s, 1000 steps an episode.

    | observation | meaning | unit |
    | --- | --- | --- |
    | 0 | height of the torso | m |
    | 1 | tilt of the torso | rad |
    | 2-4 | angles of thigh, leg and foot | rad |
    | 5, 6 | velocity forward and up, cut to [-10, 10] | m/s |
    | 7-10 | turning rates of torso, thigh, leg and foot, cut to [-10, 10] | rad/s |

    Actions are torques at thigh, leg and foot over 200 N m; MuJoCo clips them to [-1, 1], the
    reward's control cost does not. Reward, cost and end: `rules.hopper_reward`,
    `rules.hopper_cost`, `rules.hopper_fell`. `info["x_velocity"]` is the forward velocity
    they use, the mean over the step, m/s. Starts: upright, each number of qpos and qvel within
    0.005. Source: safety-gymnasium 1.0.0 on gymnasium's Hopper-v4.
    """

    info_keys = ("cost", "x_velocity")
    view = HopperView()

    def __init__(self, num_envs: int = 1, num_threads: int = 1) -> None:
        super().__init__(models.hopper(), num_envs, num_threads, SUBSTEPS)
        self.observation_space = Box(-np.inf, np.inf, (11,), np.float64)
        self.action_space = Box(-1.0, 1.0, (3,), np.float32)

    def start(self, streams: Streams, index: NDArray[np.intp]) -> None:
        """Stand the hoppers `index` up."""
        noise = (2.0 * streams.uniform(index, draws=3) - 1.0) * START_NOISE
        self.begin(index, self.model.qpos0 + noise[:, :6], noise[:, 6:])

    def step(self, action: NDArray[np.float64]) -> Outcome:
        """Move all hoppers by their actions, [num_envs, 3]."""
        before = self.qpos[:, 0].copy()
        self.advance(action)
        velocity = (self.qpos[:, 0] - before) / self.step_seconds
        reward = rules.hopper_reward(velocity, action)
        info = {"cost": rules.hopper_cost(velocity), "x_velocity": velocity}
        return Outcome(reward, rules.hopper_fell(self.qpos, self.qvel), info)

    def state_info(self) -> dict[str, NDArray[np.float64]]:
        """Return nothing: `x_velocity` belongs to the step."""
        return {}

    def observe(self) -> NDArray[np.float64]:
        """Return the observations: [num_envs, 11]."""
        return rules.hopper_observation(self.qpos, self.qvel)
