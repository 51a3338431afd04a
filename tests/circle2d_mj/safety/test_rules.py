"""Rules at limits that the recorded steps do not reach, lidars against a plain loop, constants and
starts of the velocity tasks. test_parity.py checks the rest."""

import gymnasium as gym
import numpy as np
import pytest

from circle2d_mj.core.streams import Streams
from circle2d_mj.safety import rules
from circle2d_mj.safety.tasks import VELOCITY
from circle2d_mj.safety.velocity import BODIES, VelocityTask


def test_rules_of_navigation_at_their_limits():
    assert rules.circle_reward(np.zeros(2), np.ones(2)) == 0
    assert rules.hazard_cost(np.array([0.2, 5.0])) == 0  # the rim does not count
    assert rules.hazard_cost(np.array([0.2 - 1e-9, 5.0])) == 1
    assert rules.hazard_cost(np.array([0.25]), radius=0.3) == 1
    way = rules.way_made(np.array([0.4, 2.0]), np.array([0.3, 1.5]), np.array(True))
    assert way == pytest.approx(1.6)
    assert rules.way_made(np.array([99.0]), np.array([0.0]), np.array(False)) == 10
    at = np.array([[1.2, 0.0, 9.0], [0.0, -1.2, 0.0], [1.125, -1.125, 0.0]])
    np.testing.assert_array_equal(rules.boundary_cost(at, (1.125,)), [1, 0, 0])
    np.testing.assert_array_equal(rules.boundary_cost(at, (1.125, 1.125)), [1, 1, 0])
    speeds = np.array([[[0.0, 6e-5, 0.0], [0.0, 0.0, 0.0]], [[6e-5, 6e-5, 6e-5], [0, 0, 0]]])
    np.testing.assert_array_equal(rules.speed_cost(speeds), [0, 1])  # 0.00006 and 0.000104 m/s
    quarter = rules.gremlin_offset(np.array([0.0, np.pi / 2]))
    np.testing.assert_allclose(quarter, [[0, 0.35, 0.1], [0.35, 0, 0.1]], atol=1e-15)


def test_rules_of_velocity_tasks_at_their_limits():
    np.testing.assert_array_equal(
        rules.velocity_cost(np.array([0.7402, 0.7403, -5]), 0.7402), [0, 1, 0]
    )
    action = np.array([1.0, -2.0, 3.0])
    assert rules.control_cost(action, 0.1) == 0.1 * (1 + 4 + 9)

    heights = np.array([0.6999, 0.7, 1.25, 2.0, np.nan])
    np.testing.assert_array_equal(rules.outside(heights, (0.7, 2.0)), [1, 1, 0, 1, 1])
    np.testing.assert_array_equal(rules.outside(heights, (0.7, 2.0), rim=True), [1, 0, 0, 0, 1])
    states = np.array([[0.0, 99.9], [0.0, -100.0], [np.nan, 0.0]])
    np.testing.assert_array_equal(rules.diverged(states, 100.0), [0, 1, 1])


def test_a_hopper_terminates_if_too_fast_but_not_if_far_away():
    """The limits of 100 do not concern x and height: gymnasium's hopper_v4, is_healthy."""
    task, here = VelocityTask("Hopper", 3), np.arange(3)
    qpos = np.tile([0.0, 1.25, 0.0, 0.0, 0.0, 0.0], (3, 1))
    qpos[1, 0] = 150.0
    qvel = np.zeros((3, 6))
    qvel[2, 0] = 120.0
    task.place(here, qpos, qvel)
    np.testing.assert_array_equal(task.step(np.zeros((3, 3))).terminated, [False, False, True])


def test_lidar_against_a_plain_loop():
    """The specification for one target at a time, also for tilted agents."""
    rng = np.random.default_rng(0)
    position = np.column_stack((rng.uniform(-2, 2, (50, 2)), rng.uniform(0, 0.3, 50)))
    frames = np.linalg.qr(rng.normal(size=(50, 3, 3)))[0]
    targets = rng.uniform(-2, 2, (50, 10, 2))
    groups = np.array((0, *[1] * 8, 2))
    expected = np.zeros((50, 3, 16))
    size = 2 * np.pi / 16
    for i in range(50):
        for k in range(10):
            x, y, _ = ([*targets[i, k], 0.0] - position[i]) @ frames[i]
            angle = np.arctan2(y, x) % (2 * np.pi)
            b = int(angle / size)
            s = max(0, 3.0 - np.hypot(x, y)) / 3.0
            share = (angle - b * size) / size
            row = expected[i, groups[k]]
            for at, value in [(b, s), (b + 1, share * s), (b - 1, (1 - share) * s)]:
                row[at % 16] = max(row[at % 16], value)
    inputs = targets - position[:, None, :2], position[:, 2], frames[:, :, :2]
    seen = rules.Lidars(50, groups, int(groups[-1]) + 1, 3.0)(*inputs)
    np.testing.assert_allclose(seen, expected.reshape(50, 48), atol=1e-12)
    alone = rules.Lidars(1, groups, int(groups[-1]) + 1, 3.0)(*(array[3:4] for array in inputs))
    np.testing.assert_array_equal(alone[0], seen[3])


@pytest.mark.filterwarnings("ignore")  # gymnasium deprecates v4, on which the original builds
@pytest.mark.parametrize("body", VELOCITY)
def test_constants_are_those_of_gymnasium(body):
    there, own = gym.make(f"{body}-v4").unwrapped, BODIES[body]
    assert own.substeps == there.frame_skip
    names = {"noise": "reset_noise_scale", "control_cost": "ctrl_cost_weight"}
    names |= {"alive": "healthy_reward", "forward": "forward_reward_weight"}
    names |= {"height": "healthy_z_range", "tilt": "healthy_angle_range"}
    for name, of_gymnasium in names.items():
        usual = own._field_defaults.get(name)
        assert getattr(own, name) == getattr(there, f"_{of_gymnasium}", usual), name


NOISE = {"HalfCheetah": 0.1, "Hopper": 0.005, "Swimmer": 0.1}
NOISE |= {"Walker2d": 0.005, "Ant": 0.1, "Humanoid": 0.01}


@pytest.mark.parametrize("body", VELOCITY)
def test_starts_of_velocity_tasks(body):
    """Positions are uniform within the noise; velocities too, or normal with it as deviation."""
    n, noise = 1000, NOISE[body]
    task = VelocityTask(body, n)
    task.start(Streams(np.arange(n, dtype=np.uint64)), np.arange(n))
    qpos, qvel = (task.qpos - task.model.qpos0) / noise, task.qvel / noise
    if body in ("Ant", "Humanoid"):
        np.testing.assert_allclose(np.linalg.norm(task.qpos[:, 3:7], axis=1), 1, atol=1e-12)
        qpos = np.delete(qpos, range(3, 7), axis=1)
    assert (np.abs(qpos) <= 1 + 1e-9).all()
    assert (np.abs(qpos.std(axis=0) - 1 / np.sqrt(3)) < 0.06).all()
    deviation = 1.0 if body in ("Ant", "HalfCheetah") else 1 / np.sqrt(3)
    assert (np.abs(qvel.std(axis=0) - deviation) < 0.12 * deviation).all()
    assert (np.abs(qvel).max() > 3) == (deviation == 1.0)
    numbers = np.hstack((qpos, qvel))
    assert (np.abs(numbers.mean(axis=0)) < 0.15).all()
    assert np.linalg.matrix_rank(numbers) == numbers.shape[1]
