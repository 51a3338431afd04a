"""The tasks are found without an import, and light to import."""

import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from circle2d_mj import Circle2DConfig, Circle2DEnv, Circle2DVectorEnv, SafetyGymnasiumAPI
from circle2d_mj.registration import CIRCLE2D


def run(code, folder):
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        capture_output=True,
        text=True,
        cwd=folder,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_make_without_an_import(tmp_path):
    code = """
import gymnasium as gym
env = gym.make("Circle2D-1-v0", optima_perturbation=(1.0, 0.5))
print(env.reset(seed=0)[1], env.unwrapped.config.optima_perturbation, env.spec.max_episode_steps)
envs = gym.make_vec("Circle2D-3-v0", num_envs=1024, vectorization_mode="vector_entry_point")
print(type(envs).__name__, envs.reset(seed=0)[0].shape)
"""
    assert run(code, tmp_path).splitlines() == [
        "{'cost': 0.0} (1.0, 0.5) 50",
        "Circle2DVectorEnv (1024, 2)",
    ]


def test_asking_whether_gymnasium_is_there_changes_nothing(tmp_path):
    code = """
import importlib.util, sys
before = list(sys.meta_path)
for _ in range(2):
    assert importlib.util.find_spec("gymnasium") is not None
assert "gymnasium" not in sys.modules and sys.meta_path == before
import gymnasium as gym
print(gym.make("Circle2D-1-v0").spec.id, len(sys.meta_path) - len(before))
"""
    assert run(code, tmp_path) == "Circle2D-1-v0 -1"


def test_gymnasium_works_with_a_broken_circle2d(tmp_path):
    """The plug-in must not take gymnasium down with it."""
    (tmp_path / "circle2d_mj.py").write_text("raise RuntimeError('broken')")
    code = """
import warnings
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    import gymnasium
print(gymnasium.make("CartPole-v1").spec.id, [str(w.message) for w in caught])
"""
    out = run(code, tmp_path)
    assert out == "CartPole-v1 [\"circle2d_mj is not registered: RuntimeError('broken')\"]"


def test_import_is_light(tmp_path):
    code = """
import sys, circle2d_mj
heavy = ("torch", "OpenGL", "mujoco", "matplotlib", "agents", "emcc")
print([m for m in heavy if m in sys.modules])
"""
    assert run(code, tmp_path) == "[]"


def test_every_way_gives_the_same_task():
    for level in range(4):
        config = Circle2DConfig(level=level, constraint_radius=3.0)
        arguments = {"id": f"Circle2D-{level}-v0", "constraint_radius": 3.0}
        assert gym.make(**arguments).unwrapped.config == config
        assert gym.make_vec(**arguments, num_envs=3).unwrapped.config == config
        sync = gym.make_vec(**arguments, num_envs=2, vectorization_mode="sync")
        assert sync.envs[1].unwrapped.config == config


def test_the_ids_that_are_listed_are_those_that_are_registered():
    found = {name for name in gym.registry if name.startswith("Circle2D")}
    assert set(CIRCLE2D) == found
    assert len(CIRCLE2D) == 8


def test_the_scene_is_shipped_and_loads():
    mujoco = pytest.importorskip("mujoco")
    path = Path(__file__).parents[2] / "assets" / "xml" / "circle2d.xml"
    model = mujoco.MjModel.from_xml_path(str(path))
    names = [model.joint(i).name for i in range(model.njnt)]
    assert names == ["x", "y"]
    assert (model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE).all()
    assert model.nu == 2
    data = mujoco.MjData(model)
    data.ctrl[:] = (1.0, -0.5)
    mujoco.mj_step(model, data, 100)
    np.testing.assert_allclose(data.qvel, [1.0, -0.5], rtol=0.02)


def test_six_values():
    env = SafetyGymnasiumAPI(Circle2DEnv(level=1))
    assert isinstance(env, gym.Wrapper)
    env.reset(seed=0)
    cost = 0.0
    for _ in range(20):
        observation, reward, step_cost, terminated, truncated, info = env.step([-1.0, 0.0])
        assert step_cost == info["cost"]
        assert (observation.shape, type(reward), terminated, truncated) == (
            (2,),
            float,
            False,
            False,
        )
        cost += step_cost
    assert cost >= 9
    ends = [env.step([0.0, 0.0])[3:5] for _ in range(30)]
    assert ends == [(False, False)] * 29 + [(False, True)]  # terminated, truncated
    env = SafetyGymnasiumAPI(Circle2DEnv(level=1, reset_on_cost=True))
    env.reset(seed=0)
    ends = [env.step([-1.0, 0.0])[3:5] for _ in range(20)]
    assert (True, False) in ends
    assert (False, True) not in ends
    envs = SafetyGymnasiumAPI(Circle2DVectorEnv(3, level=1))
    assert isinstance(envs, gym.vector.VectorWrapper)
    envs.reset(seed=0)
    values = envs.step(np.zeros((3, 2)))
    assert len(values) == 6
    np.testing.assert_array_equal(values[2], np.zeros(3))


class Rare(gym.Env):
    """Episodes of two steps at costs of 0.25 and 2; the info of a reset holds no cost."""

    observation_space = action_space = gym.spaces.Box(-1, 1, (1,))
    silent = False

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        return np.zeros(1, np.float32), {}

    def step(self, action):
        self.steps += 1
        info = {} if self.silent else {"cost": (0.25, 2.0)[self.steps - 1]}
        return np.zeros(1, np.float32), 0.0, self.steps == 2, False, info


@pytest.mark.parametrize(
    ("mode", "expected"),
    [
        (gym.vector.AutoresetMode.SAME_STEP, [0.25, 2.0, 0.25, 2.0]),
        (gym.vector.AutoresetMode.NEXT_STEP, [0.25, 2.0, 0.0, 0.25, 2.0, 0.0]),
    ],
)
def test_six_values_of_gymnasiums_vector_environments(mode, expected):
    """The cost of an episode's last step is neither lost to the reset nor asked of it."""
    envs = SafetyGymnasiumAPI(gym.vector.SyncVectorEnv([Rare, Rare], autoreset_mode=mode))
    envs.reset(seed=0)
    steps = [envs.step(np.zeros((2, 1), np.float32)) for _ in expected]
    costs = np.array([cost for _, _, cost, *_ in steps])
    np.testing.assert_array_equal(costs, np.array([expected] * 2).T)
    terminated = np.array([terminated for *_, terminated, _, _ in steps])
    np.testing.assert_array_equal(terminated, costs == 2.0)
    assert not any(truncated.any() for *_, truncated, _ in steps)


def test_six_values_where_one_environment_gives_no_cost():
    class Silent(Rare):
        silent = True

    envs = SafetyGymnasiumAPI(gym.vector.SyncVectorEnv([Rare, Silent]))
    envs.reset(seed=0)
    with pytest.raises(KeyError, match="sub-environment 1 gave no 'cost'"):
        envs.step(np.zeros((2, 1), np.float32))


def test_six_values_of_costs_that_gymnasium_may_have_rounded():
    class Whole(Rare):
        def step(self, action):
            *others, info = super().step(action)
            return *others, {"cost": int(info["cost"])}

    envs = SafetyGymnasiumAPI(gym.vector.SyncVectorEnv([Whole, Rare]))  # 0 and 0.25 become 0 and 0
    envs.reset(seed=0)
    with pytest.raises(TypeError, match=r"came as int64: .* let every one give a float"):
        envs.step(np.zeros((2, 1), np.float32))


def test_six_values_of_costs_that_are_comparisons():
    """numpy's bools, which gymnasium keeps as they are."""

    class Near(Rare):
        def step(self, action):
            *others, info = super().step(action)
            return *others, {"cost": np.float64(info["cost"]) > 1}

    envs = SafetyGymnasiumAPI(gym.vector.SyncVectorEnv([Near, Near]))
    envs.reset(seed=0)
    costs = [envs.step(np.zeros((2, 1), np.float32))[2].tolist() for _ in range(2)]
    assert costs == [[0.0, 0.0], [1.0, 1.0]]


def test_six_values_of_something_else():
    with pytest.raises(TypeError, match="env must be a gymnasium Env or VectorEnv, got 'Circle2D'"):
        SafetyGymnasiumAPI("Circle2D")
    env = SafetyGymnasiumAPI(gym.make("CartPole-v1"))
    env.reset(seed=0)
    with pytest.raises(KeyError, match="info has no 'cost'"):
        env.step(0)
