"""Hopper's steps and starts beside plain MuJoCo; its rules are in test_rules.py."""

import mujoco
import numpy as np

from circle2d_mj.core.streams import Streams
from circle2d_mj.safety import models
from circle2d_mj.safety.hopper import SafetyHopperVelocity


def test_steps_as_in_plain_mujoco():
    """Every step beside four of mj_step: the speed is the way in 0.008 s, the reward 1 a step and
    that speed, less a thousandth of the squared action; above 0.7402 m/s it costs."""
    n, rng = 8, np.random.default_rng(0)
    task = SafetyHopperVelocity(n)
    task.start(Streams(np.arange(n, dtype=np.uint64)), np.arange(n))
    task.qvel[::2, 0] = 2.0
    model, costs, fallen = models.hopper(), 0.0, 0
    for _ in range(60):
        qpos, qvel = task.qpos.copy(), task.qvel.copy()
        action = rng.uniform(-1, 1, (n, 3))
        reward, terminated, info = task.step(action)
        for i in range(n):
            data = mujoco.MjData(model)
            data.qpos[:], data.qvel[:], data.ctrl[:] = qpos[i], qvel[i], action[i]
            mujoco.mj_step(model, data, 4)
            np.testing.assert_allclose(task.qpos[i], data.qpos, atol=1e-6)
            velocity = (data.qpos[0] - qpos[i, 0]) / 0.008
            np.testing.assert_allclose(info["x_velocity"][i], velocity, atol=1e-3)
            np.testing.assert_allclose(
                reward[i], 1 + velocity - 1e-3 * (action[i] ** 2).sum(), atol=1e-3
            )
            if abs(velocity - 0.7402) > 1e-3:
                assert info["cost"][i] == (velocity > 0.7402)
            upright = data.qpos[1] > 0.7 and abs(data.qpos[2]) < 0.2
            assert terminated[i] == (not upright)
        costs += info["cost"].mean()
        fallen += terminated.sum()
    assert 5 < costs < 55
    assert 0 < fallen < 60 * n


def test_starts():
    """Upright, every number within 0.005 of that, evenly spread."""
    n = 400
    task = SafetyHopperVelocity(n)
    task.start(Streams(np.arange(n, dtype=np.uint64)), np.arange(n))
    numbers = np.hstack((task.qpos - models.hopper().qpos0, task.qvel)) / 0.005
    assert numbers.shape == (n, 12)
    assert (np.abs(numbers) <= 1 + 1e-9).all()
    assert (np.abs(numbers.mean(axis=0)) < 0.15).all()  # deviation of a mean: 0.029
    assert (np.abs(numbers.std(axis=0) - 1 / np.sqrt(3)) < 0.06).all()
    assert np.linalg.matrix_rank(numbers) == 12
