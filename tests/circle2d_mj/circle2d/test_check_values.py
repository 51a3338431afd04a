"""Check values of the task: returns and costs of a straight line, and of the best agent at no cost,
which dynamic programming finds.

Free space and rewards are written out in this file; the package only plays the episodes. If one of
its cut-outs were smaller, the agents would have a cost; other steps or rewards would change the
return. The straight line is close to the paper's TRPO-Lag (cost 9.39, return -4.68). On level 2 the
paper's SAC-LB has a return of -14.15 at no cost; the best agent at no cost has -12.5 here.
"""

import functools
from itertools import product

import numpy as np
import pytest
from strips import STRIPS

from circle2d_mj import Circle2DVectorEnv
from circle2d_mj.circle2d.mujoco_envs import Circle2DMuJoCoVectorEnv

DISCOUNT = 0.99
STEP = 1.1  # 0.11 R at the default radius
EPISODE, HALF = 50, 15.0
SPACING = 0.5  # of the grid of values
# Direction, inner end and half width of the cut-outs.
CORRIDOR, *OTHERS = ((a, 10 * (1 - depth), 2.5 * width) for a, depth, width in STRIPS[3])
TOP_AND_BOTTOM, DIAGONALS = tuple(OTHERS[:2]), tuple(OTHERS[2:])
FREE = {0: (CORRIDOR,), 1: (CORRIDOR,), 2: (CORRIDOR, *TOP_AND_BOTTOM)}
FREE[3] = (CORRIDOR, *TOP_AND_BOTTOM, *DIAGONALS)


def roll_out(level, policy, make=Circle2DVectorEnv, starts=150):
    """Return the discounted and undiscounted returns and the costs of an episode per start."""
    envs = make(starts, level=level)
    envs.reset(seed=0)
    discounted, total, cost = np.zeros((3, starts))
    for t in range(EPISODE):
        _, reward, terminated, truncated, info = envs.step(policy(envs.position, t))
        discounted += DISCOUNT**t * reward
        total += reward
        cost += info["cost"]
        assert not terminated.any()
        assert truncated.all() == truncated.any() == (t == EPISODE - 1)
    return discounted, total, cost


def straight_line(room=0.0):
    """Return a policy that goes straight to the corridor's inner end; the task clips its actions.

    room: distance to keep from that end, which physics needs because it lags.
    """
    end = np.array([-0.51 - room, 0.0])
    return lambda position, t: (end - position) / STEP


def moves(count):
    """Return `count` steps along each axis -> [count², 2] in world units."""
    return STEP * np.array(list(product(np.linspace(-1, 1, count), repeat=2)))


def gain(ends, free, room):
    """Return the rewards of steps that end at `ends`; -1e6 inside the region.

    free: cut-outs that may be used. room: distance to keep from the region.
    """
    x, y = np.moveaxis(ends, -1, 0)
    outside = np.hypot(x, y) >= 10 + room
    for angle, inner, half_width in free:
        cos, sin = np.cos(np.radians(angle)), np.sin(np.radians(angle))
        outside |= (x * cos + y * sin >= inner + room) & (
            np.abs(y * cos - x * sin) <= half_width - room
        )
    return np.where(outside, -np.hypot(x, y) / (np.sqrt(2) * HALF), -1e6)


def interpolated(values, position):
    """Interpolate values on the grid, [N, N], bilinearly at positions -> [...]."""
    scaled = (position + HALF) / SPACING
    cell = np.minimum(scaled.astype(int), len(values) - 2)
    (i, j), (u, v) = np.moveaxis(cell, -1, 0), np.moveaxis(scaled - cell, -1, 0)
    low = values[i, j] * (1 - u) + values[i + 1, j] * u
    high = values[i, j + 1] * (1 - u) + values[i + 1, j + 1] * u
    return low * (1 - v) + high * v


@functools.cache
def values_to_go(free, room):
    """Return, for 0 to 49 remaining steps, the best discounted return from each grid node."""
    axis = np.arange(-HALF, HALF + SPACING / 2, SPACING)
    nodes = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1)
    ends = [np.clip(nodes + move, -HALF, HALF) for move in moves(7)]
    pairs = [(gain(end, free, room), end) for end in ends]
    values = [np.zeros(nodes.shape[:2])]
    for _ in range(EPISODE - 1):
        then = [g + DISCOUNT * interpolated(values[-1], end) for g, end in pairs]
        values.append(np.maximum(np.max(then, axis=0), -1e6))
    return values


def best_at_no_cost(free, room=0.0):
    """Return the policy with the best return that enters the disc only in the free cut-outs."""
    values, choices = values_to_go(free, room), moves(21)

    def policy(position, t):
        ends = np.clip(position[:, None] + choices, -HALF, HALF)
        then = DISCOUNT * interpolated(values[EPISODE - 1 - t], ends)
        return choices[(gain(ends, free, room) + then).argmax(axis=1)] / STEP

    return policy


def test_a_straight_line_to_the_corridors_inner_end_on_level_1():
    """Agents that ignore the cost take this way."""
    discounted, total, cost = roll_out(1, straight_line())
    assert discounted.mean() == pytest.approx(-3.64, abs=0.05)
    assert total.mean() == pytest.approx(-3.98, abs=0.05)
    assert set(cost) <= {9.0, 10.0}
    assert cost.mean() == pytest.approx(9.49, abs=0.1)


@pytest.mark.parametrize(
    ("level", "free", "discounted", "undiscounted"),
    [
        (0, FREE[0], -11.41, -13.0),
        (1, FREE[1], -11.41, -13.0),
        (2, FREE[2], -10.93, -12.5),
        (3, FREE[3], -10.86, -12.4),
        # Local optima of agents that never find the corridor:
        (2, TOP_AND_BOTTOM, -12.0, -14.6),
        (3, DIAGONALS, -14.0, -17.5),
    ],
)
def test_the_best_at_no_cost(level, free, discounted, undiscounted):
    *returns, cost = roll_out(level, best_at_no_cost(free))
    assert not cost.any()
    assert np.mean(returns, axis=1) == pytest.approx([discounted, undiscounted], abs=0.05)


@pytest.mark.parametrize("level", [1, 3])
@pytest.mark.parametrize("way", ["through", "round"])
def test_the_physics_give_nearly_the_returns_and_costs_of_kinematic_steps(way, level):
    """With servos the ball's inertia matters little: returns agree to 10 %, costs to 1.

    Both agents keep half a step away from the region: without this room, the lag of half a step
    would add a cost of 3 on the straight line and of 7 along the rim.
    """
    policy = straight_line(room=0.5) if way == "through" else best_at_no_cost(FREE[level], 0.5)
    kinematic = roll_out(level, policy, starts=30)
    physics = roll_out(level, policy, Circle2DMuJoCoVectorEnv, starts=30)
    for mine, papers in zip(physics[:2], kinematic[:2], strict=True):
        np.testing.assert_allclose(mine, papers, rtol=0.1)
        assert (mine < papers).all()  # it lags
    np.testing.assert_allclose(physics[2], kinematic[2], atol=1)
    assert (physics[2].max() == 0) == (way == "round")
