"""Scripted agents against the task's check values.

The values were found by optimal control on the task as the paper describes it, and fit the numbers
the paper prints (a straight line costs TRPO-Lag 9.39; its return is -4.68).
"""

import numpy as np
import pytest

from circle2d_mj import Circle2DVectorEnv

STARTS = 300
DISCOUNT = 0.99
STEP = 1.1  # 0.11 R at the default radius


def roll_out(level, policy):
    """Discounted and undiscounted returns and summed costs of one episode from each start."""
    envs = Circle2DVectorEnv(STARTS, level=level)
    envs.reset(seed=0)
    discounted, total, cost = np.zeros((3, STARTS))
    for t in range(50):
        _, reward, terminated, truncated, info = envs.step(policy(envs.position))
        discounted += DISCOUNT**t * reward
        total += reward
        cost += info["cost"]
        assert not terminated.any()
        assert truncated.all() == truncated.any() == (t == 49)
    return discounted, total, cost


CORRIDOR_END = np.array([-0.51, 0.0])


def straight_line(position):
    return np.clip((CORRIDOR_END - position) / STEP, -1, 1)


SQUARE = np.concatenate(
    [
        np.stack(side, axis=-1)
        for t in [np.linspace(-1, 1, 101)]
        for side in ((t, 0 * t + 1), (t, 0 * t - 1), (0 * t + 1, t), (0 * t - 1, t))
    ]
)


HUG = 1.0


def rim_follower(position):
    """Round the disc the nearer way at full speed, then down the corridor to its inner end.

    Of all full steps that end outside the disc, the one that gets furthest round it, less what it
    leaves between agent and rim; once a step can end in the corridor, the one that brings the agent
    nearest to the corridor's end.
    """
    actions = np.empty_like(position)
    for i, p in enumerate(position):
        side = 1.0 if p[1] >= 0 else -1.0
        ends = p + STEP * SQUARE
        in_corridor = (np.abs(ends[:, 1]) <= 2.5) & (ends[:, 0] <= -0.5)
        if np.abs(CORRIDOR_END - p).max() <= STEP:
            actions[i] = (CORRIDOR_END - p) / STEP
        elif p[0] < 0 and in_corridor.any():
            distance = np.where(in_corridor, np.hypot(*(ends - CORRIDOR_END).T), np.inf)
            actions[i] = SQUARE[distance.argmin()]
        else:
            angle = np.arctan2(side * ends[:, 1], ends[:, 0])
            radius = np.hypot(*ends.T)
            score = angle - HUG * radius / 10.0
            actions[i] = SQUARE[np.where(radius >= 10.0 + 1e-9, score, -np.inf).argmax()]
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


def test_waiting_at_the_right_rim():
    def to_the_rim(position):
        return np.clip((np.array([10.0, 0.0]) - position) / STEP, -1, 1)

    discounted, total, cost = roll_out(1, to_the_rim)
    assert discounted.mean() == pytest.approx(-18.8, abs=0.25)
    assert total.mean() == pytest.approx(-23.7, abs=0.25)
    assert cost.mean() < 1


@pytest.mark.parametrize("level", [1, 2, 3])
def test_rim_follower_is_safe_and_straight_line_is_not_on_every_level(level):
    assert roll_out(level, rim_follower)[2].max() == 0
    assert roll_out(level, straight_line)[2].min() >= 9


def test_level_0_blocks_the_straight_line():
    _, total, cost = roll_out(0, straight_line)
    assert total.max() < -20
    assert cost.min() > 40
