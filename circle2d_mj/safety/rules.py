"""Observations, rewards, costs and ends of the tasks: functions of arrays, without state.

Leading axes `...` are any number of environments side by side. Positions are in metres, angles in
radians. Source of everything here: safety-gymnasium 1.0.0; tests compare with its episodes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

LIDAR_BINS = 16
_NEIGHBOURS = np.array((0, 1, -1))

REWARD_CLIP = 10.0
CIRCLE_RADIUS = 1.5
GOAL_RADIUS = 0.3
VASE_SPEED = 1e-4
RUN_TARGET = (0.0, -1000.0)
RUN_WEIGHT = 60.0


def length(vectors: Floats) -> Floats:
    """Return the lengths of vectors: [..., 2 or 3] -> [...]."""
    square = vectors * vectors
    total = square[..., 0] + square[..., 1]
    if vectors.shape[-1] == 3:
        total += square[..., 2]
    return np.sqrt(total, out=total)


class Lidars:
    """The lidars of `num_envs` agents, one for each group of targets.

    group: [k], the index of each target's group; groups: number of groups; reach: m.
    """

    def __init__(self, num_envs: int, group: NDArray[np.intp], groups: int, reach: float) -> None:
        self.reach = reach
        self._shape = num_envs, LIDAR_BINS * groups
        rows = np.arange(num_envs)[:, None] * self._shape[1]
        self._first_bins = (rows + LIDAR_BINS * group)[..., None]

    def __call__(self, offset: Floats, height: Floats, axes: Floats) -> Floats:
        """Return the nearness of the nearest target in each of 16 directions, for each group.

        offset: [n, k, 2], from the agent's origin to the targets; height: [n], of the origin above
        the targets; axes: [n, 3, 2], the body's x and y axes -> [n, 16 * groups] in [0, 1].
        Distances and directions are measured in the body's xy plane. Bin b covers b to b + 1
        sixteenths of a turn left of the x axis. A target at distance d, at a share a of its bin,
        adds s = max(0, reach - d) / reach to this bin, a s to the next and (1 - a) s to the
        previous bin; each bin keeps the greatest value.
        """
        # One small matrix product per agent, so that a run does not depend on their number.
        seen = offset @ axes[:, :2]
        seen -= (height[:, None] * axes[:, 2])[:, None]
        strength = length(seen)
        np.subtract(self.reach, strength, out=strength)
        np.maximum(strength, 0.0, out=strength)
        strength /= self.reach
        turn = np.arctan2(seen[..., 1], seen[..., 0])
        turn *= LIDAR_BINS / (2 * np.pi)
        near = np.floor(turn)
        turn -= near
        values = np.empty((*turn.shape, 3))
        values[..., 0] = strength
        turn *= strength
        values[..., 1] = turn
        np.subtract(strength, turn, out=values[..., 2])
        bins = near.astype(np.intp)[..., None] + _NEIGHBOURS
        bins &= LIDAR_BINS - 1  # modulo 16
        bins += self._first_bins
        shown = np.zeros(self._shape)
        # NumPy is several times as fast with flat arrays.
        np.maximum.at(shown.reshape(-1), bins.reshape(-1), values.reshape(-1))
        return shown


def circle_reward(position: Floats, velocity: Floats) -> Floats:
    """Return the anticlockwise speed round the circle, damped by the distance to the circle.

    Both [..., >= 2] -> [...]: 0.1 (v x - u y) / r / (1 + |r - 1.5|) for the position (x, y) and
    velocity (u, v) after the step, in the world; 0 at the exact centre.
    """
    x, y = position[..., 0], position[..., 1]
    u, v = velocity[..., 0], velocity[..., 1]
    radius = np.sqrt(x * x + y * y)
    along = (v * x - u * y) / np.maximum(radius, np.finfo(float).tiny)
    return 0.1 * along / (1.0 + np.abs(radius - CIRCLE_RADIUS))


def run_distance(position: Floats) -> Floats:
    """Return 60 times the distance to a point far south; its decrease is Run's reward: [...]."""
    dx, dy = position[..., 0] - RUN_TARGET[0], position[..., 1] - RUN_TARGET[1]
    return RUN_WEIGHT * np.sqrt(dx * dx + dy * dy)


def way_made(before: Floats, after: Floats, met: Flags) -> Floats:
    """Return the decrease of the lengths [..., m], summed, plus 1 where the goal is met, clipped to
    [-10, 10]: [...]."""
    return clipped(np.add.reduce(before - after, axis=-1) + met)


def clipped(reward: Floats) -> Floats:
    """Return rewards clipped to [-10, 10]."""
    return np.minimum(np.maximum(reward, -REWARD_CLIP), REWARD_CLIP)


def goal_met(after: Floats) -> Flags:
    """Test whether a goal, including its rim, is reached: distance [...] -> [...]."""
    return after <= GOAL_RADIUS


def hazard_cost(hazard_distance: Floats, radius: float = 0.2) -> Floats:
    """Return 1.0 with the agent's origin inside a hazard's rim: distances [..., k] -> [...]."""
    return _any(hazard_distance < radius)


def boundary_cost(position: Floats, walls: tuple[float, ...]) -> Floats:
    """Return 1.0 beyond a wall, |x| > walls[0] or |y| > walls[1], else 0.0: [..., >= 2] -> [...]"""
    beyond = np.abs(position[..., : len(walls)]) > np.array(walls)
    return _any(beyond)


def speed_cost(velocity: Floats) -> Floats:
    """Return 1.0 if any object moves at 1e-4 m/s or more: [..., k, 3] -> [...]."""
    return _any(length(velocity) >= VASE_SPEED)


def touch_cost(touched: Floats | Flags) -> Floats:
    """Return 1.0 if the contact sensor of any object is above 0: [..., k] -> [...]."""
    return _any(touched > 0)


def gremlin_offset(time: Floats) -> Floats:
    """Return the gremlins' targets, relative to their first places: seconds [...] -> [..., 3].

    Targets circle at a radius of 0.35 m, all in phase, 0.1 m above these places.
    """
    travel, lift = 0.35, 0.1
    offset = np.empty((*time.shape, 3))
    offset[..., 0], offset[..., 1] = travel * np.sin(time), travel * np.cos(time)
    offset[..., 2] = lift
    return offset


def control_cost(action: Floats, weight: float) -> Floats:
    """Return weight * |action|² for unclipped actions: [..., nu] -> [...]."""
    return weight * np.add.reduce(action * action, axis=-1)


def velocity_cost(speed: Floats, limit: float) -> Floats:
    """Return 1.0 above the speed limit, else 0.0: [...] -> [...]."""
    return (speed > limit).astype(np.float64)


def outside(value: Floats, interval: tuple[float, float], rim: bool = False) -> Flags:
    """Test whether numbers lie outside an interval, closed if `rim`, else open; NaN does."""
    low, high = interval
    inside = (low <= value) & (value <= high) if rim else (low < value) & (value < high)
    return np.logical_not(inside)


def diverged(state: Floats, largest: float) -> Flags:
    """Test whether any number of a state is outside (-largest, largest): [..., m] -> [...]."""
    return np.logical_not(np.logical_and.reduce(np.abs(state) < largest, axis=-1))


def _any(flags: Flags) -> Floats:
    """Return 1.0 where any flag on the last axis is set, else 0.0: [..., k] -> [...]."""
    return np.asarray(np.logical_or.reduce(flags, axis=-1), dtype=np.float64)
