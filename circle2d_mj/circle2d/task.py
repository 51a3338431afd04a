"""Observation, reward and cost of Circle2D. The place to change them.

Both modes (kinematic and MuJoCo), the single and the vector environment call these functions.
`StartArea` says where episodes start, `CostRegion` where costs lie, `Circle2DConfig` how far a step
goes. Source: safe_exploration.tex, "Circle2D details"; what it leaves open defines version v0.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from circle2d_mj.circle2d.config import Circle2DConfig


class Move(NamedTuple):
    """Result of a step of the dynamics: fresh arrays, an entry for each environment."""

    contact: NDArray[np.bool_]
    """[num_envs], whether the agent touched the cost region, for `cost`"""
    info: dict[str, NDArray[np.float64]]
    """[num_envs] for each of `Dynamics.info_units`"""


def observe(
    config: Circle2DConfig,
    position: NDArray[np.float64],
    velocity: NDArray[np.float64] | None = None,
) -> NDArray[np.float32]:
    """Scale the position by the arena's half-width, and append the velocity where there is one.

    position: [..., 2] world units -> [..., 2] float32 in [-1, 1]. velocity: [..., 2] world units a
    step -> [..., 4], its last two numbers as multiples of a full action's step.
    """
    scaled = (position * (1.0 / config.arena)).astype(np.float32)
    if velocity is None:
        return scaled
    of_full_step = velocity * (1.0 / config.full_step)
    return np.concatenate((scaled, of_full_step.astype(np.float32)), axis=-1)


def position(config: Circle2DConfig, observation: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the position of an observation: [..., 2 or 4] -> [..., 2] world units."""
    return observation[..., :2].astype(np.float64) * config.arena


def reward(config: Circle2DConfig, position: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return minus the distance to the optimum over the arena's half-diagonal.

    That is `-‖p - o‖ / (√2·m·R)`; with `sparse_reward` one more inside the corridor and the
    cut-outs, and 0 elsewhere.
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


def cost(
    config: Circle2DConfig, position: NDArray[np.float64], contact: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Return 1.0 where the agent touched the cost region in the step, else 0.0.

    position: [..., 2] world units, where the step ended; contact: [...], whether the dynamics
    report a touch (see `Kinematic.step`, `Physics.step`) -> [...] float64.
    """
    return contact.astype(np.float64)
