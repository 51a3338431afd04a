"""The three tasks as gymnasium environments, and their physics beside plain MuJoCo."""

import copy
import pickle

import gymnasium as gym
import mujoco
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.vector import AutoresetMode

from circle2d_mj.assets import asset
from circle2d_mj.core.streams import Streams
from circle2d_mj.safety import goal, models
from circle2d_mj.safety.circle import SafetyPointCircle
from circle2d_mj.safety.envs import SafetyEnv, SafetyVectorEnv
from circle2d_mj.safety.goal import SafetyPointGoal

IDS = {
    "circle2d_mj/SafetyPointCircle1-v0": (28, 2, 500, np.float64),
    "circle2d_mj/SafetyPointGoal1-v0": (60, 2, 1000, np.float64),
    "circle2d_mj/SafetyHopperVelocity-v1": (11, 3, 1000, np.float32),
}
TASKS = ["SafetyPointCircle1", "SafetyPointGoal1", "SafetyHopperVelocity"]
equal = np.testing.assert_array_equal


def vector(task, n, steps=12, mode="NextStep", **kwargs):
    return SafetyVectorEnv(task, n, max_episode_steps=steps, autoreset_mode=mode, **kwargs)


def assert_alike(mine, its):
    assert data_equivalence(mine, its, exact=True), (mine, its)


# Unbounded observations are the original's.
@pytest.mark.filterwarnings("ignore:.*A Box observation space m..imum value is -?infinity")
@pytest.mark.parametrize("name", IDS)
def test_ids(name):
    size, actions, steps, dtype = IDS[name]
    env = gym.make(name)
    check_env(env.unwrapped, skip_render_check=True)
    observation, info = env.reset(seed=0)
    assert (observation.shape, observation.dtype) == ((size,), np.float64)
    assert info["cost"] == 0.0
    assert env.action_space == gym.spaces.Box(-1, 1, (actions,), dtype)
    assert env.spec.max_episode_steps == steps
    assert gym.make(name, max_episode_steps=7).spec.max_episode_steps == 7
    envs = gym.make_vec(name, num_envs=3, vectorization_mode="vector_entry_point")
    assert isinstance(envs, SafetyVectorEnv)
    assert envs.max_episode_steps == steps
    assert envs.observation_space.shape == (3, size)


@pytest.mark.parametrize("mode", list(AutoresetMode))
@pytest.mark.parametrize("task", TASKS[:2])
def test_positions_of_the_point_are_those_that_mujoco_has(task, mode):
    """In resets, steps, autoresets of either kind and the info of the final state."""
    envs = vector(task, 3, steps=4, mode=mode)
    _, info = envs.reset(seed=1)
    final = 0
    for _ in range(9):
        at = envs.simulation.qpos[:, :2]
        equal(np.stack((info["x_position"], info["y_position"]), axis=1), at)
        assert info["_x_position"].all()
        before = at.copy()
        *_, truncated, info = envs.step(np.full((3, 2), 0.04))
        if "final_info" in info:
            final += 1
            last = np.stack([info["final_info"][f"{axis}_position"] for axis in "xy"], axis=1)
            assert 0 < np.abs(last - before).max() < 0.03  # at most 1.5 m/s for 0.02 s
            assert np.abs(last - envs.simulation.qpos[:, :2]).max() > 0.03
        if mode is AutoresetMode.DISABLED and truncated.any():
            _, info = envs.reset(options={"reset_mask": truncated})
    assert final == (2 if mode is AutoresetMode.SAME_STEP else 0)


def test_observation_bounds():
    space = SafetyVectorEnv("SafetyPointGoal1", max_episode_steps=None).single_observation_space
    assert np.isneginf(space.low[:12]).all()
    assert np.isposinf(space.high[:12]).all()
    equal(space.low[12:], 0)
    equal(space.high[12:], 1)


@pytest.mark.parametrize("mode", list(AutoresetMode))
@pytest.mark.parametrize("task", TASKS)
def test_native_equals_gymnasiums_own_vector_env(task, mode):
    """Every value of 60 steps of 5 environments, bit for bit; infos but for same-step costs.

    Positions in the info belong to the state that is observed, as gymnasium's do.
    """
    native = vector(task, 5, mode=mode)
    sync = gym.vector.SyncVectorEnv(
        [lambda: SafetyEnv(task, max_episode_steps=12)] * 5, autoreset_mode=mode
    )
    assert native.observation_space == sync.observation_space
    assert native.action_space == sync.action_space
    assert_alike(native.reset(seed=3), sync.reset(seed=3))
    native.action_space.seed(0)
    ends = 0
    for _ in range(60):
        actions = native.action_space.sample()
        ours, theirs = native.step(actions), sync.step(actions)
        done = ours[2] | ours[3]
        ends += done.sum()
        if mode is AutoresetMode.SAME_STEP and done.any():
            # gymnasium gives the infos of the reset here; ours those of the step.
            for key in set(native.simulation.info_keys) - {"x_position", "y_position"}:
                final = theirs[4]["final_info"].get(key, np.zeros(5))[done]
                equal(ours[4][key][done], final)
                theirs[4][key] = np.where(done, ours[4][key], theirs[4][key])
        for mine, its in zip(ours, theirs, strict=True):
            assert_alike(mine, its)
        if mode is AutoresetMode.DISABLED and done.any():
            results = [e.reset(options={"reset_mask": done.copy()}) for e in (native, sync)]
            assert_alike(results[0][0], results[1][0])
    assert ends >= 15


@pytest.mark.parametrize("task", TASKS)
def test_neighbours_and_threads_change_nothing(task):
    """Environment i of 40, on two threads, is environment i of 3, bit for bit."""
    few, many = vector(task, 3), vector(task, 40, num_threads=2)
    equal(few.reset(seed=7)[0], many.reset(seed=7)[0][:3])
    many.action_space.seed(0)
    for _ in range(40):
        actions = many.action_space.sample()
        mine, its = few.step(actions[:3]), many.step(actions)
        for a, b in zip(mine[:4], its[:4], strict=True):
            equal(a, b[:3])
        for key in mine[4]:
            equal(mine[4][key], its[4][key][:3])


@pytest.mark.parametrize("name", IDS)
def test_two_seeded_runs_are_equal_and_others_are_not(name):
    def run(seed):
        env = gym.make(name)
        env.action_space.seed(0)
        results = [env.reset(seed=seed)]
        results += [env.step(env.action_space.sample()) for _ in range(30)]
        return [*results, env.reset()]

    first = run(7)
    assert_alike(first, run(7))
    assert not data_equivalence(first[0], run(8)[0])
    assert not data_equivalence(first[0], first[-1])


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
@pytest.mark.parametrize("task", TASKS)
def test_copies_go_on_alike_and_apart(task, copied):
    env = vector(task, 3)
    env.reset(seed=1)
    for _ in range(5):
        env.step(env.action_space.sample())
    twin, other = copied(env), copied(env)
    equal(env.simulation.observe(), twin.simulation.observe())
    other.step(-np.ones(env.action_space.shape))
    for _ in range(40):
        action = env.action_space.sample()
        assert_alike(env.step(action), twin.step(action))
    single = SafetyEnv(task, max_episode_steps=None)
    single.reset(seed=1)
    twin = copied(single)
    assert_alike(
        single.step(env.action_space.sample()[0] * 0), twin.step(env.action_space.sample()[0] * 0)
    )


@pytest.mark.parametrize("task", TASKS)
def test_state_and_restore(task):
    """Into a used environment and into one that was never reset: resets and new goals included."""
    env, used, new = (vector(task, 4, steps=30) for _ in range(3))
    env.reset(seed=5)
    used.reset(seed=99)
    for _ in range(40):
        env.step(env.action_space.sample())
        used.step(env.action_space.sample())
    state = env.state_dict()
    assert all(len(array) == 4 for array in state.values())
    kept = copy.deepcopy(state)
    for other in (used, new):
        other.load_state_dict(state)
        equal(other.simulation.observe(), env.simulation.observe())
    for _ in range(50):
        action = env.action_space.sample()
        results = [e.step(action) for e in (env, used, new)]
        assert_alike(results[0], results[1])
        assert_alike(results[0], results[2])
    assert_alike(state, kept)  # neither stepping nor restoring has touched it
    with pytest.raises(ValueError, match="state must hold"):
        used.load_state_dict({**state, "mujoco": state["mujoco"][:, :-1]})


def test_new_goals_follow_the_restored_streams():
    env = vector("SafetyPointGoal1", 2)
    env.reset(seed=0)
    state = env.state_dict()
    width = env.simulation.model.nq
    state["places"][:, 0] = state["places"][:, 1]  # agents on their goals
    state["mujoco"][:, 1:3] = state["places"][:, 1]  # after the time, qpos
    assert width == 10
    goals = []
    for seed in (1, 2):
        other = vector("SafetyPointGoal1", 2)
        other.reset(seed=seed)
        other.load_state_dict(state)
        info = other.step(np.zeros((2, 2)))[4]
        equal(info["goal_met"], 1.0)
        goals.append(other.state_dict()["places"][:, 1])
    equal(*goals)
    assert (goals[0] != state["places"][:, 1]).all()


def test_actions_are_clipped():
    for task in TASKS[:2]:
        results = []
        for scale in (1.0, 50.0):
            env = SafetyEnv(task, max_episode_steps=None)
            env.reset(seed=0)
            results.append([env.step([scale, -scale]) for _ in range(3)])
        assert_alike(*results)
    env = SafetyEnv("SafetyHopperVelocity", max_episode_steps=None)
    observations, rewards = [], []
    for scale in (1.0, 2.0):
        env.reset(seed=0)
        observation, reward, *_ = env.step([scale] * 3)
        observations.append(observation)
        rewards.append(reward)
    equal(*observations)
    assert rewards[0] - rewards[1] == pytest.approx(0.001 * (12 - 3))


def plain_step(model, qpos, qvel, control, substeps=10):
    """One environment step by mj_step on an MjData of its own."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.ctrl[:] = qpos, qvel, control
    mujoco.mj_step(model, data, substeps)
    return data.qpos.copy(), data.qvel.copy()


def test_the_agent_pushes_the_vase_as_in_plain_mujoco():
    """Agents driven at the vase from afar, every step beside mj_step with all its contacts."""
    n = 8
    task = SafetyPointGoal(n)
    task.start(Streams(np.arange(n, dtype=np.uint64)), np.arange(n))
    places = task.state_dict()["places"]
    angle = np.arange(n) * 2 * np.pi / n
    aim = np.stack((np.cos(angle), np.sin(angle)), axis=1)
    task.qpos[:, :2] = places[:, 10] - 0.9 * aim
    task.qpos[:, 2] = angle + np.linspace(-0.1, 0.1, n)
    places[:, 0] = task.qpos[:, :2]
    task.load_state_dict({**task.state_dict(), "places": places})
    model, stood, touched = models.point_goal(), 0, 0
    control = np.tile([0.05, 0.0], (n, 1))
    for _ in range(90):
        qpos, qvel = task.qpos.copy(), task.qvel.copy()
        task.step(control)
        for i in range(n):
            expected = plain_step(model, qpos[i], qvel[i], control[i])
            np.testing.assert_allclose(task.qpos[i], expected[0], atol=1e-6)
            np.testing.assert_allclose(task.qvel[i], expected[1], atol=2e-5)
        stood += (task.qpos[:, 3:] == qpos[:, 3:]).all(axis=1).sum()
        touched += (np.abs(task.qpos[:, 3:5] - qpos[:, 3:5]).max(axis=1) > 1e-3).sum()
    assert stood > 20 * n / 2
    assert touched > 5 * n
    assert (np.linalg.norm(task.qpos[:, 3:5] - places[:, 10], axis=1) > 0.1).all()
    equal(task.state_dict()["places"][:, 10], task.qpos[:, 3:5])


def test_out_of_reach():
    """No contact between agent and vase beyond 0.31 m, and no agent faster than 1.6 m/s."""
    model, rng = models.point_goal(), np.random.default_rng(0)
    data, farthest = mujoco.MjData(model), 0.0
    vase = model.geom("vase0").id
    for _ in range(3000):
        distance, angle = rng.uniform(0.2, 0.5), rng.uniform(0, 2 * np.pi)
        data.qpos[2] = rng.uniform(0, 2 * np.pi)
        data.qpos[3:6] = distance * np.cos(angle), distance * np.sin(angle), 0.1
        data.qpos[6:] = rng.normal(size=4)
        mujoco.mj_forward(model, data)
        if any(vase in pair and 0 not in pair for pair in data.contact.geom):
            farthest = max(farthest, distance)
    task = SafetyPointCircle(64)
    task.start(Streams(np.arange(64, dtype=np.uint64)), np.arange(64))
    turn, fastest = np.where(np.arange(64) < 32, 0.0, rng.uniform(-1, 1, 64)), 0.0
    for _ in range(300):
        task.step(np.stack((np.ones(64), turn), axis=1))
        fastest = max(fastest, np.linalg.norm(task.qvel[:, :2], axis=1).max())
    assert 0.25 < farthest < 0.35
    assert 1.3 < fastest < 1.6
    assert farthest + 0.02 * fastest < goal.OUT_OF_REACH


def test_data_shows_the_world():
    env = vector("SafetyPointGoal1", 3)
    env.reset(seed=0)
    task = env.simulation
    before = env.state_dict()
    data, places = task.data(1), task.state_dict()["places"][1]
    names = ["agent", "goal", *[f"hazard{i}" for i in range(8)], "vase0"]
    for name, place in zip(names, places, strict=True):
        np.testing.assert_allclose(data.geom(name).xpos[:2], place, atol=1e-12)
    equal(data.qpos, task.qpos[1])
    equal(data.sensordata, task.sensors[1])
    assert_alike(env.state_dict(), before)
    for name in TASKS:
        assert (
            vector(name, 2).simulation.data(1).qpos.shape
            == vector(name, 2).simulation.qpos[1].shape
        )


def test_bad_arguments():
    with pytest.raises(ValueError, match=r"task must be one of \['SafetyPointCircle1'"):
        SafetyVectorEnv("SafetyCarGoal1", max_episode_steps=None)
    for name, value, error in [
        ("num_envs", 0, ValueError),
        ("num_envs", 1.5, TypeError),
        ("num_threads", -1, ValueError),
        ("max_episode_steps", 0, ValueError),
        ("render_mode", "ansi", ValueError),
    ]:
        with pytest.raises(error, match=name):
            SafetyVectorEnv("SafetyPointGoal1", **{"max_episode_steps": None, name: value})


def test_assets():
    assert asset("xml/circle2d.xml").is_file()
    with pytest.raises(FileNotFoundError, match=r"no asset 'xml/circle.xml'; there are \["):
        asset("xml/circle.xml")
