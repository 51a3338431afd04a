"""Observations, rewards, costs and ends of the tasks: functions of arrays, without state.

Leading axes `...` are any number of environments side by side. Positions are in metres, angles in
radians. Source of everything here: safety-gymnasium 1.0.0, whose recorded episodes the tests hold.
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


def distance(position: Floats, targets: Floats) -> Floats:
    """Return the planar distances: [..., 2 or 3] and [..., k, 2] -> [..., k]."""
    dx = targets[..., 0] - position[..., None, 0]
    dy = targets[..., 1] - position[..., None, 1]
    return np.sqrt(dx * dx + dy * dy)


def lidar(
    position: Floats, axes: Floats, targets: Floats, reach: float, group: NDArray[np.intp]
) -> Floats:
    """Return the nearness of the nearest target in each of 16 directions, for each group.

    position: [..., 3]; axes: [..., 3, 2], the body's x and y; targets: [..., k, 2], on the floor;
    group: [k], the number of each target's group, ascending from 0 -> [..., 16 * groups] in [0, 1].
    All is measured in the body's plane. Bin b looks from b to b + 1 sixteenths of a turn left of
    the x axis. A target at distance d, a share a into its bin, shows there with
    s = max(0, reach - d) / reach, in the next bin with a s and in the one before with (1 - a) s;
    each bin keeps the greatest.
    """
    dx = targets[..., 0] - position[..., None, 0]
    dy = targets[..., 1] - position[..., None, 1]
    dz = -position[..., None, 2]
    ahead = dx * axes[..., None, 0, 0] + dy * axes[..., None, 1, 0] + dz * axes[..., None, 2, 0]
    left = dx * axes[..., None, 0, 1] + dy * axes[..., None, 1, 1] + dz * axes[..., None, 2, 1]
    strength = np.maximum(reach - np.sqrt(ahead * ahead + left * left), 0.0)
    strength /= reach
    turn = np.arctan2(left, ahead)
    turn *= LIDAR_BINS / (2 * np.pi)
    turn %= LIDAR_BINS
    near = turn.astype(np.intp)
    share = turn - near
    values = np.empty((*turn.shape, 3))
    values[..., 0] = strength
    np.multiply(share, strength, out=values[..., 1])
    np.multiply(1.0 - share, strength, out=values[..., 2])
    bins = near[..., None] + _NEIGHBOURS
    bins &= LIDAR_BINS - 1  # modulo 16; `near` is 16 where % has rounded up to it
    bins += LIDAR_BINS * group[:, None]
    width = LIDAR_BINS * (int(group[-1]) + 1)
    shown = np.zeros((*turn.shape[:-1], width))
    bins += np.arange(0, shown.size, width).reshape(*turn.shape[:-1], 1, 1)
    np.maximum.at(shown.reshape(-1), bins, values)
    return shown


def circle_reward(position: Floats, velocity: Floats) -> Floats:
    """Return the speed round the circle, anticlockwise, damped by the distance to it.

    Both [..., >= 2] -> [...]: 0.1 (v x - u y) / r / (1 + |r - 1.5|) for the position (x, y) and
    velocity (u, v) after the step, in the world; 0 at the very centre.
    """
    x, y = position[..., 0], position[..., 1]
    u, v = velocity[..., 0], velocity[..., 1]
    radius = np.sqrt(x * x + y * y)
    along = (v * x - u * y) / np.maximum(radius, np.finfo(float).tiny)
    return 0.1 * along / (1.0 + np.abs(radius - CIRCLE_RADIUS))


def run_distance(position: Floats) -> Floats:
    """Return 60 times the distance to the far south, whose decrease is Run's reward: [...]."""
    dx, dy = position[..., 0] - RUN_TARGET[0], position[..., 1] - RUN_TARGET[1]
    return RUN_WEIGHT * np.sqrt(dx * dx + dy * dy)


def way_made(before: Floats, after: Floats, met: Flags) -> Floats:
    """Return by how much the lengths [..., m] became shorter, plus 1 where the goal is met, within
    [-10, 10]: [...]."""
    return clipped(np.asarray((before - after).sum(axis=-1)) + met)


def clipped(reward: Floats) -> Floats:
    """Return rewards within [-10, 10]."""
    return np.asarray(np.clip(reward, -REWARD_CLIP, REWARD_CLIP))


def goal_met(after: Floats) -> Flags:
    """Test whether a goal is reached, its rim included: distance [...] -> [...]."""
    return after <= GOAL_RADIUS


def hazard_cost(hazard_distance: Floats, radius: float = 0.2) -> Floats:
    """Return 1.0 with the agent's origin in a hazard, rim excluded: distances [..., k] -> [...]."""
    return np.asarray((hazard_distance < radius).any(axis=-1), dtype=np.float64)


def boundary_cost(position: Floats, walls: tuple[float, ...]) -> Floats:
    """Return 1.0 beyond a wall, |x| > walls[0] or |y| > walls[1], else 0.0: [..., >= 2] -> [...]"""
    beyond = np.abs(position[..., : len(walls)]) > np.array(walls)
    return np.asarray(beyond.any(axis=-1), dtype=np.float64)


def speed_cost(velocity: Floats) -> Floats:
    """Return 1.0 where an object moves at 1e-4 m/s or more: [..., k, 3] -> [...]."""
    speed = np.sqrt((velocity * velocity).sum(axis=-1))
    return np.asarray((speed >= VASE_SPEED).any(axis=-1), dtype=np.float64)


def touch_cost(touched: Floats | Flags) -> Floats:
    """Return 1.0 where a contact sensor of an object is above 0: [..., k] -> [...]."""
    return np.asarray((touched > 0).any(axis=-1), dtype=np.float64)


def gremlin_offset(time: Floats) -> Floats:
    """Return where gremlins aim, relative to their places at the start: seconds [...] -> [..., 3].

    They circle at 0.35 m, all in phase, 0.1 m above where they started.
    """
    travel, lift = 0.35, 0.1
    offset = np.empty((*time.shape, 3))
    offset[..., 0], offset[..., 1] = travel * np.sin(time), travel * np.cos(time)
    offset[..., 2] = lift
    return offset


def velocity_reward(
    speed: Floats, action: Floats, forward: float, alive: float, control: float
) -> Floats:
    """Return forward * speed + alive - control * |action|²: [...] and [..., nu], not clipped."""
    return forward * speed + alive - control * (action * action).sum(axis=-1)


def velocity_cost(speed: Floats, limit: float) -> Floats:
    """Return 1.0 above the speed limit, else 0.0: [...] -> [...]."""
    return (speed > limit).astype(np.float64)


def fell(
    height: Floats,
    tilt: Floats,
    rest: Floats,
    heights: tuple[float, float],
    tilts: tuple[float, float],
    largest: float,
    rim: bool = False,
) -> Flags:
    """Test whether a body is too low, too high or tilted, or diverges.

    height, tilt: [...]; rest: [..., m] numbers that must be within (-largest, largest); heights,
    tilts: open intervals, `heights` closed where `rim` -> [...].
    """
    low, high = heights
    upright = (low <= height) & (height <= high) if rim else (low < height) & (height < high)
    upright &= (tilts[0] < tilt) & (tilt < tilts[1]) & (np.abs(rest) < largest).all(axis=-1)
    return np.logical_not(upright)
