"""The physics against plain MuJoCo, and against itself after resets; scenes of one's own."""

import gymnasium as gym
import mujoco
import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence

from circle2d_mj.assets import asset
from circle2d_mj.circle2d import task
from circle2d_mj.circle2d.mujoco_envs import Circle2DMuJoCoEnv, Circle2DMuJoCoVectorEnv
from circle2d_mj.circle2d.physics_config import PhysicsConfig
from circle2d_mj.circle2d.scene import scene


class Loop:
    """One environment stepped by mj_step alone, with contacts on; mj_forward gives overlaps."""

    def __init__(self, config, actuation, position, with_region=True):
        physics = PhysicsConfig(actuation=actuation)
        self.model = scene(config, physics, with_region=with_region).compile()
        self.data, self._fresh = mujoco.MjData(self.model), mujoco.MjData(self.model)
        self.data.qpos[:] = position

    def step(self, action):
        """Take ten physics steps; return [10, 3]: contacts and overlap after each, force during."""
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
    """Draw actions, some beyond 1, that lead into the region, along its edges and through it."""
    rng = np.random.default_rng(seed)
    drift = rng.uniform([-1, -0.4], [0.2, 0.4], size=(num_envs, 2))
    return drift + rng.normal(scale=0.5, size=(steps, num_envs, 2))


@pytest.mark.parametrize("actuation", ["velocity", "force"])
@pytest.mark.parametrize("level", [0, 1, 2, 3])
def test_the_environment_equals_a_loop_of_mj_step(level, actuation):
    """Bit for bit, with contacts always on and actions clipped; if the region can be entered, the
    loop of a scene without a region moves alike."""
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


def test_a_scene_of_ones_own(tmp_path):
    """A ball that runs into an added wall stops at it, and touching it costs 1. A copy of the base
    scene changes nothing."""
    text = asset("xml/circle2d.xml").read_text()
    own, copy = tmp_path / "own.xml", tmp_path / "copy.xml"
    wall = '<geom name="wall" type="box" pos="12 0 0.5" size="0.1 15 2"/>'
    own.write_text(text.replace("<body name", f"{wall}<body name", 1))
    copy.write_text(text)
    lines = {}
    for name, more in (("own", {"xml": str(own)}), ("copy", {"xml": copy}), ("usual", {})):
        envs = Circle2DMuJoCoVectorEnv(3, level=0, autoreset_mode="Disabled", **more)
        envs.reset(seed=0)
        envs.simulation.dynamics.place(np.arange(3), np.array([[14.0, y] for y in (-1, 0, 1)]))
        lines[name] = [envs.step(np.tile([-1.0, 0.0], (3, 1))) for _ in range(4)]
        lines[name] = [(envs.position, r, i["cost"]) for _, r, _, _, i in lines[name]]
    for ours, usual in zip(lines["copy"], lines["usual"], strict=True):
        for mine, theirs in zip(ours, usual, strict=True):
            np.testing.assert_array_equal(mine, theirs)
    position, _, cost = lines["own"][-1]
    # Half the wall's width and the ball's radius beyond the wall's middle, less some penetration.
    np.testing.assert_allclose(position[:, 0], 12 + 0.1 + 0.25, atol=0.1)
    assert cost.tolist() == [1.0] * 3
    assert lines["own"][0][2].tolist() == [0.0] * 3
    assert (lines["usual"][-1][0][:, 0] < 11.5).all()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("", "<", "is no scene that MuJoCo reads"),
        ('geom name="floor"', 'geom name="ground"', 'needs a geom "floor"'),
        ("<inertial", '<joint name="z" type="slide"/><inertial', "two joints of all"),
        ('<default class="region">', '<default class="other">', 'default class "region"'),
        ('geom name="floor"', 'geom name="region0"', r'"floor".*no region.*start from a copy of'),
    ],
)
def test_a_scene_that_lacks_something_is_refused(old, new, words, tmp_path):
    path = tmp_path / "own.xml"
    path.write_text(asset("xml/circle2d.xml").read_text().replace(old, new, 1))
    with pytest.raises(ValueError, match=f"xml '.*own.xml' .*{words}"):
        Circle2DMuJoCoEnv(xml=path)


def test_a_scene_that_is_no_file_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"none\.xml' is no scene that MuJoCo reads"):
        Circle2DMuJoCoEnv(xml=tmp_path / "none.xml")
    with pytest.raises(TypeError, match="xml must be the path of a file, got 3"):
        Circle2DMuJoCoEnv(xml=3)


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_drawn_parameters_are_in_the_info(mode):
    """They are those of the MuJoCo models. In the same-step mode, info belongs to the episode that
    is observed, and final_info to the episode that ended."""
    ranges = {"mass": (0.5, 2.0), "damping": (0.0, 1.0)}
    envs = Circle2DMuJoCoVectorEnv(4, randomize=ranges, autoreset_mode=mode, max_episode_steps=3)
    before = envs.reset(seed=1)[1]
    assert len({*before["mass"]}) == 4
    for step in range(1, 4):
        info = envs.step(np.zeros((4, 2)))[-1]
        physics = envs.simulation.dynamics
        models = [physics._batch.get_model(k) for k in range(4)]
        assert info["mass"].tolist() == [model.body("agent").mass[0] for model in models]
        assert info["damping"].tolist() == [model.dof_damping[0] for model in models]
        same = mode == "NextStep" or step < 3
        assert (info["mass"] == before["mass"]).all() == same
    if mode == "SameStep":
        assert info["final_info"]["mass"].tolist() == before["mass"].tolist()
    env = gym.make("Circle2DMuJoCo-1-v0", randomize=ranges)
    assert 0.5 <= env.reset(seed=0)[1]["mass"] <= 2
    assert "mass" not in gym.make("Circle2DMuJoCo-1-v0").reset(seed=0)[1]
