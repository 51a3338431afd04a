"""The paper's dynamics: the action is the step, and only its end point is tested."""

from __future__ import annotations

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from circle2d_mj import task
from circle2d_mj.config import Circle2DConfig

STEP = 0.11
"""Length of a full action on each axis, as a multiple of `constraint_radius`."""


class Kinematic:
    """The positions of `num_envs` agents and how actions move them."""

    def __init__(self, config: Circle2DConfig, num_envs: int) -> None:
        self.config = config
        self.observation_space = Box(-1.0, 1.0, (2,), np.float32)
        # Columns lie together in memory: every formula works on x and y apart.
        self.position = np.zeros((num_envs, 2), order="F")
        """[num_envs, 2], world units."""

    def place(self, index: NDArray[np.intp], position: NDArray[np.float64]) -> None:
        """Put the agents `index` at `position`, [len(index), 2]."""
        self.position[index] = position

    def step(self, action: NDArray[np.float64]) -> NDArray[np.float64]:
        """Move every agent and return the costs: `p' = clip(p + 0.11·R·a, arena)`.

        action: [num_envs, 2], clipped to [-1, 1] -> [num_envs]. Where the region cannot be entered
        a move that ends in it is taken back, and costs all the same.
        """
        config, arena = self.config, self.config.arena
        end = action.T.copy().T  # a fresh array in the memory order of `position`
        np.maximum(end, -1.0, out=end)
        np.minimum(end, 1.0, out=end)
        end *= STEP * config.constraint_radius
        end += self.position
        np.maximum(end, -arena, out=end)
        np.minimum(end, arena, out=end)
        cost = task.cost(config, end)
        if not config.infeasible_region_penetratable:
            end = np.where(cost[:, None] > 0, self.position, end)
        self.position = end
        return cost

    def observe(self) -> NDArray[np.float32]:
        """What the agents see: [num_envs, 2] float32."""
        return task.observe(self.config, self.position)
