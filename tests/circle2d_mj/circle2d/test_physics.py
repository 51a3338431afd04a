"""The physics against plain MuJoCo, hand arithmetic, and itself after copies and resets."""

import mujoco
import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence

from circle2d_mj.circle2d import task
from circle2d_mj.circle2d.mujoco_envs import Circle2DMuJoCoEnv, Circle2DMuJoCoVectorEnv
from circle2d_mj.circle2d.physics_config import PhysicsConfig
from circle2d_mj.circle2d.scene import scene


class Loop:
    """One environment stepped by mj_step alone, the region's contacts on; read by mj_forward."""

    def __init__(self, config, actuation, position, with_region=True):
        physics = PhysicsConfig(actuation=actuation)
        self.model = scene(config, physics, with_region=with_region).compile()
        self.data, self._fresh = mujoco.MjData(self.model), mujoco.MjData(self.model)
        self.data.qpos[:] = position

    def step(self, action):
        """Of each of ten physics steps: contacts and overlap after it, force during it."""
        self.data.ctrl[:] = self.model.actuator_ctrlrange[:, 1] * np.clip(action, -1, 1)
        steps = []
        for _ in range(10):
            mujoco.mj_step(self.model, self.data)
            force = self._force()
            self._fresh.qpos[:] = self.data.qpos
            mujoco.mj_forward(self.model, self._fresh)
            overlaps = [-contact.dist for contact in self._fresh.contact]
            steps.append((self._fresh.ncon, max([0.0, *overlaps]), force))
        return np.array(steps)

    def _force(self):
        total, local = np.zeros(3), np.zeros(6)
        for i, contact in enumerate(self.data.contact):
            mujoco.mj_contactForce(self.model, self.data, i, local)
            total += contact.frame.reshape(3, 3).T @ local[:3]
        return np.hypot.reduce(total)


def drift_left(seed, steps=50, num_envs=4):
    """Actions, some beyond 1, that bring agents into the region, along its edges and through it."""
    rng = np.random.default_rng(seed)
    drift = rng.uniform([-1, -0.4], [0.2, 0.4], size=(num_envs, 2))
    return drift + rng.normal(scale=0.5, size=(steps, num_envs, 2))


@pytest.mark.parametrize("actuation", ["velocity", "force"])
@pytest.mark.parametrize("level", [0, 1, 2, 3])
def test_the_environment_is_a_loop_of_mj_step(level, actuation):
    """Bit for bit, contacts on all the while, actions clipped; and where the region can be entered,
    also without a region."""
    envs = Circle2DMuJoCoVectorEnv(3, level=level, actuation=actuation, autoreset_mode="Disabled")
    envs.reset(seed=level)
    config = envs.config
    loops = [Loop(config, actuation, p) for p in envs.position]
    alone = [Loop(config, actuation, p, with_region=False) for p in envs.position]
    assert alone[0].model.nmesh == 0
    cost_steps = 0
    for action in drift_left(level, steps=25, num_envs=3):
        _, reward, _, _, info = envs.step(action)
        told = np.array([loop.step(a) for loop, a in zip(loops, action, strict=True)])
        for loop, a in zip(alone, action, strict=True):
            loop.step(a)
        position = np.array([loop.data.qpos for loop in loops])
        np.testing.assert_array_equal(envs.position, position)
        np.testing.assert_array_equal(reward, task.reward(config, position))
        touches, overlap, force = told.transpose(2, 0, 1)
        if level == 0:
            np.testing.assert_array_equal(info["cost"], touches.max(axis=1) > 0)
            np.testing.assert_array_equal(info["penetration"], overlap.max(axis=1))
            np.testing.assert_allclose(info["contact_force"], force.max(axis=1), rtol=1e-12)
        else:
            np.testing.assert_array_equal(info["cost"], touches[:, -1] > 0)
            np.testing.assert_array_equal(info["penetration"], config.region.depth(position))
            assert not info["contact_force"].any()
            np.testing.assert_array_equal([loop.data.qpos for loop in alone], position)
            velocity = envs.state_dict()["mujoco"][:, 3:5]
            np.testing.assert_array_equal([loop.data.qvel for loop in alone], velocity)
        cost_steps += info["cost"].sum()
    assert 10 < cost_steps < 65
    state = envs.state_dict()["mujoco"]
    expected = np.empty_like(state)
    for loop, row in zip(loops, expected, strict=True):
        mujoco.mj_getState(loop.model, loop.data, row, mujoco.mjtState.mjSTATE_INTEGRATION)
    np.testing.assert_array_equal(state, expected)


def test_a_reset_forgets_everything():
    """An episode does not depend on what came before it, warm starts included."""
    used, fresh = (Circle2DMuJoCoEnv(level=0, actuation="force") for _ in range(2))
    used.reset(seed=0)
    for action in drift_left(5, num_envs=1):
        used.step(action[0])
    assert data_equivalence(used.reset(seed=9), fresh.reset(seed=9), exact=True)
    assert data_equivalence(used.state_dict(), fresh.state_dict(), exact=True)
    for action in drift_left(6, num_envs=1):
        assert data_equivalence(used.step(action[0]), fresh.step(action[0]), exact=True)
