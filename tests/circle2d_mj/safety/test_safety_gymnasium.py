"""The interface of safety-gymnasium, used as published code uses that package."""

import pickle
import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers.utils import RunningMeanStd

import circle2d_mj.safety_gymnasium as safety_gymnasium
from circle2d_mj.safety.tasks import NAMES, OLD, VISION
from circle2d_mj.safety_gymnasium import wrappers
from circle2d_mj.safety_gymnasium.vector import SafetyAsyncVectorEnv
from circle2d_mj.safety_gymnasium.wrappers import SafeNormalizeObservation, SafeRescaleAction

equal = np.testing.assert_array_equal


@pytest.mark.parametrize(
    "name", ["SafetyPointButton1-v0", "SafetyCarGoal2-v0", "SafetyAntVelocity-v1"]
)
def test_six_values_are_the_environments(name):
    """Values are those of `gymnasium.make`, with the cost apart; infos have the original's keys."""
    env, five = safety_gymnasium.make(name), gym.make(f"circle2d_mj/{name}")
    observation, info = env.reset(seed=3)
    equal(observation, five.reset(seed=3)[0])
    assert info == {}
    env.action_space.seed(0)
    for _ in range(20):
        action = env.action_space.sample()
        got, expected = env.step(action), five.step(action)
        equal(got[0], expected[0])
        assert (got[1], got[3], got[4]) == (expected[1], expected[2], expected[3])
        assert got[2] == got[5]["cost_sum"] == expected[4]["cost"]
        assert got[5].get("goal_met", False) in (True, bool(expected[4].get("goal_met", 0)))
    assert env.env.spec.max_episode_steps == env.spec.max_episode_steps == 1000
    assert env.spec.id == env.unwrapped.spec.id == name
    assert set(safety_gymnasium.registry) == {*NAMES.values(), *OLD, *VISION}


def test_the_attribute_task_shows_the_simulation():
    env = safety_gymnasium.make("SafetyPointPush1-v0")
    env.reset(seed=0)
    task, simulation = env.unwrapped.task, env.unwrapped._envs.simulation
    assert env.task.agent_name == task.agent_name == "Point"
    equal(task.agent.pos, [*simulation.qpos[0, :2], 0.1])
    equal(task.push_box.pos, simulation.qpos[0, 3:6])
    assert [len(place) for place in task.hazards.pos] == [3, 3]
    assert (task.goal.pos[2], task.goal.size, task.goal_achieved) == (0.16, 0.3, False)
    with pytest.raises(AttributeError, match="task has no 'vases'; it has"):
        _ = task.vases


@pytest.mark.parametrize("name", ["SafetyPointGoal1-v0", "SafetyCarGoal1-v0"])
def test_the_agent_as_model_based_code_reads_it(name):
    """OmniSafe reads its rotation and sensors, and computes the places of objects in its frame."""
    env = safety_gymnasium.make(name)
    env.reset(seed=1)
    for _ in range(20):
        before = env.task.agent.pos
        observation = env.step(np.array([0.7, 0.4]))[0]
    agent = env.task.agent
    sensors = ("accelerometer", "velocimeter", "gyro", "magnetometer")
    equal(np.concatenate([agent.get_sensor(sensor) for sensor in sensors]), observation[:12])
    np.testing.assert_allclose(agent.mat.T @ agent.mat, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(agent.mat.T @ [0.0, -0.5, 0.0], agent.get_sensor("magnetometer"))
    seconds = env.unwrapped._envs.simulation.step_seconds
    np.testing.assert_allclose(agent.vel, (agent.pos - before) / seconds, atol=0.1)
    x, y, _ = (env.task.goal.pos * [1, 1, 0] - agent.pos) @ agent.mat
    lidar = observation[env.unwrapped._envs.simulation.agent.sensors :][:16]
    nearest = int(np.arctan2(y, x) * 16 / (2 * np.pi) % 16)
    assert lidar[nearest] == pytest.approx(1 - np.hypot(x, y) / 3)


def test_bad_ids_are_named():
    for make in (safety_gymnasium.make, safety_gymnasium.vector.make):
        with pytest.raises(ValueError, match=r"one of `registry`, such as Safety.*, got "):
            make("SafetyRacecarRace1-v0")


def test_a_single_environment_in_the_wrappers_that_safepo_uses():
    env = safety_gymnasium.make("SafetyPointGoal1-v0", max_episode_steps=5)
    env.reset(seed=0)
    env = wrappers.SafeAutoResetWrapper(env)
    env = SafeRescaleAction(env, -2.0, 2.0)
    env = SafeNormalizeObservation(env)
    env = wrappers.SafeUnsqueeze(env)
    equal(env.action_space.high, [2, 2])
    observations = [env.reset(seed=1)[0]]
    for _ in range(5):
        result = env.step(np.array([[2.0, 0.0]]))
        assert [value.shape for value in result[:5]] == [(1, 60), (1,), (1,), (1,), (1,)]
        observations.append(result[0])
    assert result[4].all()
    assert result[5]["final_observation"].shape == (1, 60)
    plain, rms = safety_gymnasium.make("SafetyPointGoal1-v0"), RunningMeanStd(shape=(60,))
    seen = [plain.reset(seed=1)[0]]
    seen += [plain.step(np.array([1.0, 0.0]))[0] for _ in range(5)]
    for one in seen[:-1]:
        rms.update(one[None])
    expected = (seen[-1] - rms.mean) / np.sqrt(rms.var + 1e-8)  # before the next episode's first
    np.testing.assert_allclose(result[5]["final_observation"][0], expected, rtol=1e-12)
    equal(result[5]["original_final_observation"][0], seen[-1])
    assert env.obs_rms.count == pytest.approx(6, abs=1e-3)


def test_rescaled_actions_are_the_originals_and_can_be_pickled():
    """The Humanoid's actions are within 0.4. As in the original, actions beyond the bounds are not
    clipped: they change the control cost."""
    name = "SafetyHumanoidVelocity-v1"
    env = SafeRescaleAction(safety_gymnasium.make(name), -1.0, 3.0)
    env.reset(seed=0)
    env = pickle.loads(pickle.dumps(env))
    plain = safety_gymnasium.make(name)
    plain.reset(seed=0)
    equal(env.action_space.low, [-1.0] * 17)
    equal(env.action_space.high, [3.0] * 17)
    for action, inside in ((-1.0, -0.4), (1.0, 0.0), (3.0, 0.4), (5.0, 0.8)):
        got, expected = env.step(np.full(17, action)), plain.step(np.full(17, inside))
        np.testing.assert_allclose(got[1], expected[1], rtol=1e-6)


def test_a_vector_environment_as_omnisafe_uses_it():
    envs = safety_gymnasium.vector.make(
        env_id="SafetyPointGoal1-v0", num_envs=3, max_episode_steps=4
    )
    single = [safety_gymnasium.make("SafetyPointGoal1-v0") for _ in range(3)]
    observation, _ = envs.reset(seed=7)
    equal(observation, [env.reset(seed=7 + i)[0] for i, env in enumerate(single)])
    for _ in range(4):
        actions = np.full((3, 2), 0.3)
        observation, reward, cost, terminated, truncated, info = envs.step(actions)
        results = [env.step(action) for env, action in zip(single, actions, strict=True)]
        equal(reward, [result[1] for result in results])
        equal(cost, [result[2] for result in results])
        equal(info["cost_hazards"], [result[5]["cost_hazards"] for result in results])
    assert truncated.all()
    assert not terminated.any()
    equal(np.stack(info["final_observation"]), [result[0] for result in results])
    assert (observation != np.stack(info["final_observation"])).any()
    assert info["final_info"][2]["cost"] == results[2][2]
    assert envs.single_action_space == single[0].action_space


def test_a_spec_keeps_its_parameters_and_its_time_limit():
    made = safety_gymnasium.make("SafetyPointGoal1-v0", hazards=3, max_episode_steps=7)
    for id, limit in ((made.spec, 7), ("SafetyPointGoal1-v0", 1000)):
        again = safety_gymnasium.make(id)
        assert again.spec.max_episode_steps == limit
        assert again.unwrapped.task.hazards.num == {7: 3, 1000: 8}[limit]
    assert safety_gymnasium.make(made.spec, hazards=2).unwrapped.task.hazards.num == 2


@pytest.mark.parametrize("wrappers", [None, []], ids=["native", "one by one"])
def test_without_a_time_limit_it_is_the_tasks_own(wrappers):
    for limit, expected in ((None, 500), (3, 3)):
        envs = safety_gymnasium.vector.make(
            "SafetyPointCircle1-v0", 2, wrappers=wrappers, max_episode_steps=limit
        )
        envs.reset(seed=0)
        ends = [envs.step(np.zeros((2, 2)))[4].all() for _ in range(expected)]
        assert ends == [False] * (expected - 1) + [True]


def test_a_vector_of_wrapped_environments_as_safepo_makes_it():
    def make():
        return SafeRescaleAction(safety_gymnasium.make("SafetyCarGoal1-v0", 6), -1.0, 1.0)

    envs = SafeNormalizeObservation(SafetyAsyncVectorEnv([make, make]))
    made = safety_gymnasium.vector.make(
        "SafetyCarGoal1-v0", 2, wrappers=lambda e: SafeRescaleAction(e, -1, 1), max_episode_steps=6
    )
    assert envs.reset(seed=0)[0].shape == (2, 72)
    made.reset(seed=0)
    for _ in range(6):
        observation, reward, cost, _, truncated, info = envs.step(np.full((2, 2), 0.5))
        result = made.step(np.full((2, 2), 0.5))
        equal(reward, result[1])
        equal(cost, result[2])
    assert observation.shape == (2, 72)
    assert truncated.all()
    assert info["final_observation"][1].shape == (72,)
    assert info["_final_observation"].all()
    envs.close()


@pytest.mark.parametrize(
    ("wrapper", "place"), [(wrappers.SafeNormalizeReward, 1), (wrappers.SafeNormalizeCost, 2)]
)
def test_rewards_and_costs_over_the_deviation_of_their_discounted_sum(wrapper, place):
    """The sum starts anew only at a termination, as in the original and in gymnasium's
    NormalizeReward."""

    class Scripted(gym.Env):
        def step(self, action):
            return 0, action, action, action == 2, action == 4, {}

    env, expected = wrapper(Scripted(), 0.5), RunningMeanStd(shape=())
    for number, total in [(1, 1.0), (2, 2.0), (3, 4.0), (4, 6.0), (5, 8.0)]:
        found = env.step(number)[place]
        expected.update(np.array([total]))
        assert found == pytest.approx(number / np.sqrt(expected.var + 1e-8))


def test_wrappers_are_gymnasium_wrappers():
    """They give spec, task and the inner environment; gymnasium's wrappers can wrap them."""
    env = safety_gymnasium.make("SafetyPointGoal1-v0")
    for wrapper in (wrappers.SafetyGymnasium2Gymnasium, SafeNormalizeObservation):
        wrapped = wrapper(env)
        assert isinstance(wrapped, gym.Wrapper)
        assert wrapped.unwrapped is env.unwrapped and wrapped.spec.id == env.spec.id
        assert wrapped.task.agent_name == "Point"
    five = gym.wrappers.RecordEpisodeStatistics(wrappers.SafetyGymnasium2Gymnasium(env))
    five.reset(seed=np.int64(7), options={"unknown": 1})
    assert five.step(np.zeros(2))[4]["cost"] == 0.0
    six = wrappers.with_gymnasium_wrappers(env, gym.wrappers.ClipAction)
    observation, _ = six.reset(seed=7)
    equal(observation, safety_gymnasium.make("SafetyPointGoal1-v0").reset(seed=7)[0])
    assert len(six.step(np.full(2, 3.0))) == 6 and six.unwrapped is env.unwrapped


def test_conversion_of_vector_environments():
    """Values are those of the six, and gymnasium's vector wrappers can wrap the conversion."""
    six = safety_gymnasium.vector.make("SafetyCarGoal1-v0", 3, max_episode_steps=2)
    made = safety_gymnasium.vector.make("SafetyCarGoal1-v0", 3, max_episode_steps=2)
    five = gym.wrappers.vector.RecordEpisodeStatistics(wrappers.SafetyGymnasium2Gymnasium(made))
    equal(six.reset(seed=0, options={"unknown": 1})[0], five.reset(seed=0)[0])
    assert [task.agent_name for task in five.env.get_attr("task")] == ["Car"] * 3
    for _ in range(3):
        expected, got = six.step(np.ones((3, 2))), five.step(np.ones((3, 2)))
        equal(got[0], expected[0])
        equal(got[4]["cost"], expected[2])


@pytest.mark.parametrize("wrap", [None, []], ids=["native", "one by one"])
def test_reading_from_the_copies_of_a_vector_environment(wrap):
    envs = safety_gymnasium.vector.make("SafetyCarGoal1-v0", 3, wrappers=wrap)
    observation, _ = envs.reset(seed=5)
    assert isinstance(envs, gym.vector.VectorEnv)
    tasks = envs.get_attr("task")
    for i, task in enumerate(tasks):
        single = safety_gymnasium.make("SafetyCarGoal1-v0")
        equal(single.reset(seed=5 + i)[0], observation[i])
        equal(task.agent.pos, single.task.agent.pos)
        equal(task.hazards.pos, single.task.hazards.pos)
    assert envs.call("render_mode") == (None, None, None)
    envs.step_async(np.ones((3, 2)))
    assert envs.step_wait()[2].shape == (3,)


def test_copies_that_are_stepped_together_cannot_be_written():
    envs = safety_gymnasium.vector.make("SafetyCarGoal1-v0", 3)
    with pytest.raises(AttributeError, match=r"hazards cannot be set: .*hazards=\.\.\."):
        envs.set_attr("hazards", 3)


def test_the_ids_that_end_in_gymnasium_have_five_values_and_convert_to_six():
    five = gym.make("SafetyPointGoal1Gymnasium-v0")
    six = wrappers.Gymnasium2SafetyGymnasium(five)
    results = []
    for made in (five, six):
        made.reset(seed=0)
        results.append(made.step(np.zeros(2)))
    assert [len(result) for result in results] == [5, 6]
    assert results[0][4]["cost"] == 0.0


def test_install():
    """In a separate process; it is refused if the original package has been imported."""
    code = """
import importlib.util, sys
import circle2d_mj.safety_gymnasium as ours
ours.install(); ours.install()
import safety_gymnasium
from safety_gymnasium.vector.async_vector_env import SafetyAsyncVectorEnv
from safety_gymnasium.vector.utils.tile_images import tile_images
from safety_gymnasium.wrappers import SafeAutoResetWrapper
assert safety_gymnasium is ours and importlib.util.find_spec("safety_gymnasium")
assert len(safety_gymnasium.make("SafetyCarButton2-v0").reset()[0]) == 88
sys.modules["safety_gymnasium"] = importlib.util
try:
    ours.install()
except RuntimeError as error:
    print(error)
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.startswith("safety_gymnasium has been imported already, from ")


IMPORTS = """
import safety_gymnasium
import safety_gymnasium as sg; sg.make, sg.vector.make, sg.wrappers.SafeTimeLimit
from safety_gymnasium import *
from safety_gymnasium import __version__
from safety_gymnasium import gymnasium_make, gymnasium_register
from safety_gymnasium import make, register
from safety_gymnasium import make_ma
from safety_gymnasium import vector, wrappers
from safety_gymnasium.version import __version__
from safety_gymnasium.utils.registration import make, register, safe_registry, spec
from safety_gymnasium.utils.common_utils import ResamplingError
from safety_gymnasium.vector import SafetyAsyncVectorEnv, SafetySyncVectorEnv, VectorEnv, make
from safety_gymnasium.vector.async_vector_env import SafetyAsyncVectorEnv
from safety_gymnasium.vector.sync_vector_env import SafetySyncVectorEnv
from safety_gymnasium.vector.utils.tile_images import tile_images
import safety_gymnasium.vector.async_vector_env as module; module.SafetyAsyncVectorEnv
from safety_gymnasium.wrappers import SafeAutoResetWrapper, SafeNormalizeObservation
from safety_gymnasium.wrappers import SafePassiveEnvChecker, SafeRescaleAction, SafeUnsqueeze
from safety_gymnasium.wrappers import with_gymnasium_wrappers
from safety_gymnasium.wrappers.autoreset import SafeAutoResetWrapper
from safety_gymnasium.wrappers.env_checker import SafePassiveEnvChecker
from safety_gymnasium.wrappers.gymnasium_conversion import Gymnasium2SafetyGymnasium
from safety_gymnasium.wrappers.gymnasium_conversion import make_gymnasium_environment
from safety_gymnasium.wrappers.normalize import SafeNormalizeCost, SafeNormalizeReward
from safety_gymnasium.wrappers.rescale_action import SafeRescaleAction
from safety_gymnasium.wrappers.time_limit import SafeTimeLimit
from safety_gymnasium.wrappers.unsqueeze import SafeUnsqueeze
from safety_gymnasium.tasks.safe_multi_agent.safe_mujoco_multi import SafeMAEnv
from safety_gymnasium.tasks.safe_multi_agent.tasks.velocity.safe_mujoco_multi import SafeMAEnv
import importlib.metadata; assert importlib.metadata.version("safety-gymnasium") == "1.0.0"
"""
SPAWNS = """
import multiprocessing, subprocess, sys
import circle2d_mj.safety_gymnasium
ASKS = "import safety_gymnasium; print(len(safety_gymnasium.registry))"
if __name__ == "__main__":
    circle2d_mj.safety_gymnasium.install()
    subprocess.run([sys.executable, "-c", ASKS], check=True)
    child = multiprocessing.get_context("spawn").Process(target=exec, args=(ASKS,))
    child.start(); child.join()
"""


def outside(*command, **options):
    """Run a command, which must succeed; return its output."""
    return subprocess.run(command, capture_output=True, text=True, check=True, **options).stdout


def test_imports_of_published_code_in_a_program_that_is_run(tmp_path):
    (tmp_path / "program.py").write_text(f"{IMPORTS}print(safety_gymnasium.__file__)")
    run = (sys.executable, "-m", "circle2d_mj.safety_gymnasium")
    for program in (["program.py"], ["python", "program.py"]):
        assert outside(*run, *program, cwd=tmp_path).strip() == safety_gymnasium.__file__
    none = subprocess.run([*run, "no-such-program"], capture_output=True, text=True)
    assert (none.returncode, none.stderr) == (2, "no-such-program: no such program\n")


def test_install_reaches_child_processes(tmp_path):
    (tmp_path / "spawns.py").write_text(SPAWNS)
    there = outside(sys.executable, "spawns.py", cwd=tmp_path).split()
    assert there == [str(len(safety_gymnasium.registry))] * 2


def test_modules_that_are_missing_say_what_to_use_instead(tmp_path):
    """Also modules whose parent is a single file in this package."""
    lines = []
    for module in ("bases", "tasks.safe_navigation", "utils.task_utils"):
        lines += ["try:", f"    import safety_gymnasium.{module}", "except ImportError as error:"]
        lines += ["    print(error)"]
    run = (sys.executable, "-m", "circle2d_mj.safety_gymnasium", "python", "-c", "\n".join(lines))
    told = outside(*run, cwd=tmp_path).splitlines()
    assert len(told) == 3
    for line in told:
        assert line.startswith("safety_gymnasium.") and "use circle2d_mj.safety.own" in line
    with pytest.raises(NotImplementedError, match="multi-agent"):
        safety_gymnasium.make_ma("Ant", "2x4")


class Six(gym.Env):
    """A user's environment with six values."""

    observation_space = action_space = gym.spaces.Box(-1.0, 1.0, (1,))

    def __init__(self, cost=1.0, render_mode=None):
        self.cost = cost

    def reset(self, *, seed=None, options=None):
        return np.zeros(1, np.float32), {}

    def step(self, action):
        return np.zeros(1, np.float32), 0.5, self.cost, False, False, {}


def test_a_registered_environment_of_the_users():
    safety_gymnasium.register(id="Six-v0", entry_point=Six, max_episode_steps=3)
    assert "Six-v0" in safety_gymnasium.making.safe_registry
    env = safety_gymnasium.make("Six-v0", cost=2.0)
    env.reset()
    assert [env.step(np.zeros(1))[2:5] for _ in range(3)] == [
        (2.0, False, False),
        (2.0, False, False),
        (2.0, False, True),
    ]
    assert env.spec.id == "Six-v0"
    envs = safety_gymnasium.vector.make("Six-v0", 2)
    envs.reset()
    equal(envs.step(np.zeros((2, 1)))[2], [1.0, 1.0])
    del gym.registry["Six-v0"], safety_gymnasium.registry["Six-v0"]


def test_tile_images():
    """Three pictures of 2 x 1 pixels in two rows: the last place is empty, each has a black rim."""
    pictures = np.arange(1, 7).reshape(3, 2, 1, 1)
    expected = [[0, 0, 0, 0, 0, 0], [0, 1, 0, 0, 3, 0], [0, 2, 0, 0, 4, 0], [0, 0, 0, 0, 0, 0]]
    expected += [[0, 0, 0, 0, 0, 0], [0, 5, 0, 0, 0, 0], [0, 6, 0, 0, 0, 0], [0, 0, 0, 0, 0, 0]]
    equal(safety_gymnasium.vector.tile_images(pictures, padding=1)[..., 0], expected)


def test_infos_of_vector_environments_are_those_of_single_ones():
    """`goal_met` is in an info only if a goal is met; driving copies meet some."""
    native = safety_gymnasium.vector.make("SafetyPointGoal0-v0", 20, max_episode_steps=150)
    alone = safety_gymnasium.vector.make("SafetyPointGoal0-v0", 20, wrappers=[])
    assert native.reset(seed=0)[1] == alone.reset(seed=0)[1] == {}
    actions = np.stack([np.full(20, 0.3), np.linspace(-0.05, 0.05, 20)], axis=-1)
    told = [(native.step(actions)[5], alone.step(actions)[5]) for _ in range(149)]
    met = [[info.get("_goal_met", np.zeros(20, bool)).tolist() for info in pair] for pair in told]
    assert all(ours == theirs for ours, theirs in met) and np.any(met)
    assert {key for info, _ in told for key in info} == {key for _, info in told for key in info}
    for last in native.step(actions)[5]["final_info"]:
        assert last["cost_sum"] == last["cost"] and last.get("goal_met", True) is True
