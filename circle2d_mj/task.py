"""The task: observation, reward and cost as functions of positions. The place to change them.

Both modes (kinematic and MuJoCo), the single and the vector environment call these. Where episodes
start is `StartArea`; where costs lie is `CostRegion`.
Source: safe_exploration.tex, "Circle2D details"; what it leaves open defines version v0.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from circle2d_mj.config import Circle2DConfig


def observe(config: Circle2DConfig, position: NDArray[np.float64]) -> NDArray[np.float32]:
    """The position as a fraction of the arena's half-width.

    position: [..., 2] world units -> [..., 2] float32 in [-1, 1].
    """
    return (position * (1.0 / config.arena)).astype(np.float32)


def reward(config: Circle2DConfig, position: NDArray[np.float64]) -> NDArray[np.float64]:
    """Minus the distance to the optimum, over the arena's half-diagonal: `-‖p - o‖ / (√2·m·R)`.

    With `sparse_reward`, one less that distance inside the corridor and the cut-outs, else 0.
    position: [..., 2] world units -> [...] float64; in [-1, 0] for the default optimum.
    """
    x, y = position[..., 0], position[..., 1]
    optimum_x, optimum_y = config.optima_perturbation
    if optimum_x or optimum_y:
        x, y = x - optimum_x, y - optimum_y
    minus_distance = np.sqrt(x * x + y * y) * (-1.0 / (math.sqrt(2.0) * config.arena))
    if config.sparse_reward:
        return np.where(config.region.in_cutout(position), 1.0 + minus_distance, 0.0)
    return minus_distance


def cost(config: Circle2DConfig, position: NDArray[np.float64]) -> NDArray[np.float64]:
    """1.0 where the agent stands in the cost region (or would, were it not rigid), else 0.0.

    position: [..., 2] world units -> [...] float64. The rim counts as outside (open disc).
    """
    return config.region.contains(position).astype(np.float64)
