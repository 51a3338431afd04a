"""SafetyPointCircle1-v0: run round a circle without leaving the strip between two walls."""

from __future__ import annotations

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from circle2d_mj.core.simulation import Outcome
from circle2d_mj.core.streams import Streams
from circle2d_mj.safety import models, rules
from circle2d_mj.safety.mujoco_task import MuJoCoTask
from circle2d_mj.safety.views import PointCircleView

START_HALF_WIDTH = 0.8
SUBSTEPS = 10
SENSORS = 12


def point_observation_space(lidars: int) -> Box:
    """Return the Point agent's space: 12 unbounded sensors, 16 bins in [0, 1] for each lidar."""
    bins = lidars * rules.LIDAR_BINS
    low = np.concatenate((np.full(SENSORS, -np.inf), np.zeros(bins)))
    high = np.concatenate((np.full(SENSORS, np.inf), np.ones(bins)))
    return Box(low, high, dtype=np.float64)


def point_action_space() -> Box:
    """Return the Point agent's space: thrust and turning rate, in float64 as in safety-gymnasium.

    Stable-Baselines3 advises float32. Actions of that type are taken too, and without loss; the
    space keeps the original's type, so that its samples and those who compare are not rounded.
    """
    return Box(-1.0, 1.0, (2,), np.float64)


def point_position(qpos: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Return the Point agents' positions for the info, m. qpos: [num_envs, nq]."""
    return {"x_position": qpos[:, 0].copy(), "y_position": qpos[:, 1].copy()}


class SafetyPointCircle(MuJoCoTask):
    """`num_envs` copies of the task. Positions in metres, steps of 0.02 s, 500 steps an episode.

    | observation | meaning, in the agent's frame: x ahead, y left, z up | unit |
    | --- | --- | --- |
    | 0-2 | accelerometer | m/s² |
    | 3-5 | velocity | m/s |
    | 6-8 | turning rate | rad/s |
    | 9-11 | magnetometer: a field along the world's -y | |
    | 12-27 | lidar of the circle's centre, reach 6 m: see `rules.lidar` | |

    | action | meaning; MuJoCo clips it to [-1, 1] |
    | --- | --- |
    | 0 | thrust ahead, which saturates at 0.05 |
    | 1 | turning rate aimed at |

    | info | meaning | unit |
    | --- | --- | --- |
    | cost | 1.0 where the step ended beyond a wall, else 0.0 | |
    | x_position, y_position | where the agent is in the world | m |

    Reward and cost: `rules.circle_reward`, `rules.circle_cost`. It never terminates. Starts are
    uniform in [-0.8, 0.8]² with any heading, at rest. Source: safety-gymnasium 1.0.0.
    """

    info_keys = ("cost", "x_position", "y_position")
    view = PointCircleView()

    def __init__(self, num_envs: int = 1, num_threads: int = 1) -> None:
        super().__init__(models.point_circle(), num_envs, num_threads, SUBSTEPS)
        self.observation_space = point_observation_space(lidars=1)
        self.action_space = point_action_space()
        self._centre = np.zeros((self.num_envs, 1, 2))

    def start(self, streams: Streams, index: NDArray[np.intp]) -> None:
        """Place the agents `index` at random, at rest."""
        pose = streams.uniform(index)[:, :3]
        pose[:, :2] = (2.0 * pose[:, :2] - 1.0) * START_HALF_WIDTH
        pose[:, 2] *= 2.0 * np.pi
        self.begin(index, pose)

    def step(self, action: NDArray[np.float64]) -> Outcome:
        """Move all agents by their actions, [num_envs, 2]."""
        self.advance(action)
        position = self.qpos[:, :2]
        reward = rules.circle_reward(position, self.qvel[:, :2])
        info = {"cost": rules.circle_cost(position)}
        return Outcome(reward, np.zeros(self.num_envs, dtype=bool), info)

    def state_info(self) -> dict[str, NDArray[np.float64]]:
        """Return the agents' positions."""
        return point_position(self.qpos)

    def observe(self) -> NDArray[np.float64]:
        """Return the observations: [num_envs, 28]."""
        seen = rules.sight(self.qpos[:, :2], self._centre)
        lidar = rules.lidar(seen, self.qpos[:, 2], rules.CIRCLE_LIDAR_REACH)
        return np.concatenate((self.sensors, lidar), axis=1)
