"""Scripted agents and the best at no cost, found by dynamic programming: the task's check values.

The values were found by optimal control on the task as the paper describes it, and fit the numbers
the paper prints (a straight line costs TRPO-Lag 9.39; its return is -4.68). What is free and what a
step earns is written out here; the package only plays the episodes: a cut-out that is smaller there
shows as cost, other steps or rewards show as another return.
"""

import functools
from itertools import product

import numpy as np
import pytest
from strips import STRIPS

from circle2d_mj import Circle2DVectorEnv
from circle2d_mj.circle2d.mujoco_envs import Circle2DMuJoCoVectorEnv

STARTS = 300
DISCOUNT = 0.99
STEP = 1.1  # 0.11 R at the default radius


@functools.cache
def roll_out(level, policy, make=Circle2DVectorEnv, starts=STARTS):
    """Discounted and undiscounted returns and summed costs of one episode from each start."""
    envs = make(starts, level=level)
    envs.reset(seed=0)
    discounted, total, cost = np.zeros((3, starts))
    for t in range(50):
        _, reward, terminated, truncated, info = envs.step(policy(envs.position))
        discounted += DISCOUNT**t * reward
        total += reward
        cost += info["cost"]
        assert not terminated.any()
        assert truncated.all() == truncated.any() == (t == 49)
    return discounted, total, cost


CORRIDOR_END = np.array([-0.51, 0.0])


def straight_line(position, room=0.0):
    """room: how far from the region it ends; physics that lag behind need some."""
    return np.clip((CORRIDOR_END - [room, 0.0] - position) / STEP, -1, 1)


SQUARE = np.concatenate(
    [
        np.stack(side, axis=-1)
        for t in [np.linspace(-1, 1, 101)]
        for side in ((t, 0 * t + 1), (t, 0 * t - 1), (0 * t + 1, t), (0 * t - 1, t))
    ]
)


HUG = 1.0


def rim_follower(position, room=0.0):
    """Round the disc the nearer way at full speed, then down the corridor to its inner end.

    Of all full steps that end outside the disc, the one that gets furthest round it, less what it
    leaves between agent and rim; once a step can end in the corridor, the one that brings the agent
    nearest to the corridor's end. room: what it keeps off the region.
    """
    goal = CORRIDOR_END - [room, 0.0]
    actions = np.empty_like(position)
    for i, p in enumerate(position):
        side = 1.0 if p[1] >= 0 else -1.0
        ends = p + STEP * SQUARE
        in_corridor = (np.abs(ends[:, 1]) <= 2.5 - room) & (ends[:, 0] <= -0.5 - room)
        if np.abs(goal - p).max() <= STEP:
            actions[i] = (goal - p) / STEP
        elif p[0] < 0 and in_corridor.any():
            distance = np.where(in_corridor, np.hypot(*(ends - goal).T), np.inf)
            actions[i] = SQUARE[distance.argmin()]
        else:
            angle = np.arctan2(side * ends[:, 1], ends[:, 0])
            radius = np.hypot(*ends.T)
            score = angle - HUG * radius / 10.0
            actions[i] = SQUARE[np.where(radius >= 10.0 + room + 1e-9, score, -np.inf).argmax()]
    return actions


def test_straight_through_level_1():
    """To the corridor's inner end and no further, as agents do that ignore the cost."""
    discounted, total, cost = roll_out(1, straight_line)
    assert discounted.mean() == pytest.approx(-3.64, abs=0.05)
    assert total.mean() == pytest.approx(-3.98, abs=0.05)
    assert set(cost) <= {9.0, 10.0}
    assert cost.mean() == pytest.approx(9.49, abs=0.1)


def test_rim_follower_level_1():
    discounted, _, cost = roll_out(1, rim_follower)
    assert cost.max() == 0
    assert -12.0 < discounted.mean() < -11.2
    assert discounted.min() >= -13.0
    assert discounted.max() <= -10.6


@pytest.mark.parametrize("level", [1, 2, 3])
def test_rim_follower_is_safe_and_straight_line_is_not_on_every_level(level):
    assert roll_out(level, rim_follower)[2].max() == 0
    assert roll_out(level, straight_line)[2].min() >= 9


@pytest.mark.parametrize("level", [1, 2, 3])
@pytest.mark.parametrize("policy", [straight_line, rim_follower])
def test_the_physics_give_what_the_papers_steps_give(policy, level):
    """With servos the ball's inertia counts for little: returns to 10 %, costs to 1 a crossing.

    Both agents keep half a step off the region: with none to spare, as above, the lag of half a
    step costs 3 more on the straight line and 7 along the rim.
    """

    def with_room(position):
        return policy(position, room=0.5)

    kinematic = roll_out(level, with_room, starts=50)
    physics = roll_out(level, with_room, Circle2DMuJoCoVectorEnv, starts=50)
    for mine, papers in zip(physics[:2], kinematic[:2], strict=True):
        np.testing.assert_allclose(mine, papers, rtol=0.1)
        assert (mine < papers).all()  # it lags
    np.testing.assert_allclose(physics[2], kinematic[2], atol=1)
    assert (physics[2].max() == 0) == (policy is rim_follower)


EPISODE, HALF = 50, 15.0
SPACING = 0.5  # of the grid that holds values
# Direction, inner end and half width of the cut-outs.
CORRIDOR, *OTHERS = ((a, 10 * (1 - depth), 2.5 * width) for a, depth, width in STRIPS[3])
TOP_AND_BOTTOM, DIAGONALS = tuple(OTHERS[:2]), tuple(OTHERS[2:])


def moves(count):
    """`count` steps along each axis -> [count², 2] in world units."""
    return STEP * np.array(list(product(np.linspace(-1, 1, count), repeat=2)))


def gain(ends, free):
    """The reward of a step that ends there, or a price nobody pays; free: cut-outs of the disc."""
    x, y = np.moveaxis(ends, -1, 0)
    outside = np.hypot(x, y) >= 10
    for angle, inner, half_width in free:
        cos, sin = np.cos(np.radians(angle)), np.sin(np.radians(angle))
        outside |= (x * cos + y * sin >= inner) & (np.abs(y * cos - x * sin) <= half_width)
    return np.where(outside, -np.hypot(x, y) / (np.sqrt(2) * HALF), -1e6)


def interpolated(values, position):
    """Bilinear, of values on the grid [N, N] -> [...]."""
    scaled = (position + HALF) / SPACING
    cell = np.minimum(scaled.astype(int), len(values) - 2)
    (i, j), (u, v) = np.moveaxis(cell, -1, 0), np.moveaxis(scaled - cell, -1, 0)
    low = values[i, j] * (1 - u) + values[i + 1, j] * u
    high = values[i, j + 1] * (1 - u) + values[i + 1, j + 1] * u
    return low * (1 - v) + high * v


@functools.cache
def values_to_go(free):
    """The best discounted return of the steps that are left, 0 to 49, from the nodes of a grid."""
    axis = np.arange(-HALF, HALF + SPACING / 2, SPACING)
    nodes = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1)
    ends = [np.clip(nodes + move, -HALF, HALF) for move in moves(7)]
    pairs = [(gain(end, free), end) for end in ends]
    values = [np.zeros(nodes.shape[:2])]
    for _ in range(EPISODE - 1):
        then = [g + DISCOUNT * interpolated(values[-1], end) for g, end in pairs]
        values.append(np.maximum(np.max(then, axis=0), -1e6))
    return values


@pytest.mark.parametrize(
    ("level", "free", "discounted", "undiscounted"),
    [
        (0, (CORRIDOR,), -11.41, -13.0),
        (1, (CORRIDOR,), -11.41, -13.0),
        (2, (CORRIDOR, *TOP_AND_BOTTOM), -10.93, -12.5),
        (3, (CORRIDOR, *TOP_AND_BOTTOM, *DIAGONALS), -10.86, -12.4),
        # What those settle for who never find the corridor:
        (2, TOP_AND_BOTTOM, -12.0, -14.6),
        (3, DIAGONALS, -14.0, -17.5),
    ],
)
def test_the_best_at_no_cost(level, free, discounted, undiscounted):
    values = values_to_go(free)
    envs = Circle2DVectorEnv(300, level=level)
    envs.reset(seed=0)
    returns, choices = np.zeros((2, 300)), moves(21)
    for t in range(EPISODE):
        ends = np.clip(envs.position[:, None] + choices, -HALF, HALF)
        best = gain(ends, free) + DISCOUNT * interpolated(values[EPISODE - 1 - t], ends)
        _, reward, *_, info = envs.step(choices[best.argmax(axis=1)] / STEP)
        assert not info["cost"].any()
        returns += np.array([[DISCOUNT**t], [1.0]]) * reward
    means = returns.mean(axis=1)
    assert means == pytest.approx([discounted, undiscounted], abs=0.05)
