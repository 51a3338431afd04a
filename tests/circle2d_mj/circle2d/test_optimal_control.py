"""The best that each level allows at no cost, found by dynamic programming: the check values.

What is free and what a step earns is written out here; the package only plays the episodes. A
cut-out that is smaller there shows as cost, other steps or rewards show as another return.
"""

from itertools import product

import numpy as np
import pytest
from strips import STRIPS

from circle2d_mj import Circle2DVectorEnv

DISCOUNT, EPISODE, HALF, STEP = 0.99, 50, 15.0, 1.1
SPACING = 0.5  # of the grid that holds values
# Direction, inner end and half width of the cut-outs.
CORRIDOR, *OTHERS = ((a, 10 * (1 - depth), 2.5 * width) for a, depth, width in STRIPS[3])
TOP_AND_BOTTOM, DIAGONALS = OTHERS[:2], OTHERS[2:]


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
