"""Starts of the velocity tasks, and what the Humanoid sees; their steps: test_parity.py."""

import mujoco
import numpy as np
import pytest

from circle2d_mj.core.streams import Streams
from circle2d_mj.safety.tasks import VELOCITY
from circle2d_mj.safety.velocity import VelocityTask

NOISE = {"HalfCheetah": 0.1, "Hopper": 0.005, "Swimmer": 0.1}
NOISE |= {"Walker2d": 0.005, "Ant": 0.1, "Humanoid": 0.01}


def started(body, n):
    task = VelocityTask(body, n)
    task.start(Streams(np.arange(n, dtype=np.uint64)), np.arange(n))
    return task


@pytest.mark.parametrize("body", VELOCITY)
def test_starts(body):
    """Positions within the noise of their rest; velocities too, or normal with that deviation."""
    n, noise = 1000, NOISE[body]
    task = started(body, n)
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


def test_the_humanoid_feels_contacts():
    """Its forces are those of an MjData of its own after mj_step and mj_rnePostConstraint."""
    task, plain = started("Humanoid", 3), []
    for i in range(3):
        data = mujoco.MjData(task.model)
        data.qpos[:], data.qvel[:] = task.qpos[i], task.qvel[i]
        plain.append(data)
    forces, rng = slice(-84, None), np.random.default_rng(0)
    np.testing.assert_array_equal(task.observe()[:, forces], 0)
    for _ in range(45):
        action = rng.uniform(-0.4, 0.4, (3, 17))
        task.step(action)
    for i, data in enumerate(plain):
        rng = np.random.default_rng(0)
        for _ in range(45):
            data.ctrl[:] = rng.uniform(-0.4, 0.4, (3, 17))[i]
            mujoco.mj_step(task.model, data, 5)
        mujoco.mj_rnePostConstraint(task.model, data)
        assert np.abs(data.cfrc_ext).max() > 1
        np.testing.assert_allclose(task.observe()[i, forces], data.cfrc_ext.ravel(), atol=1e-6)
