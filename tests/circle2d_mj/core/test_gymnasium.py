"""gymnasium's own checks, and its contract for vector environments."""

import copy
import pickle
from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.utils.env_match import check_environments_match
from gymnasium.vector import AutoresetMode

from circle2d_mj import Circle2DEnv, Circle2DVectorEnv
from circle2d_mj.circle2d.mujoco_envs import Circle2DMuJoCoEnv, Circle2DMuJoCoVectorEnv

LEVELS = range(4)
SINGLE = {"Circle2D": Circle2DEnv, "Circle2DMuJoCo": Circle2DMuJoCoEnv}
VECTOR = {"Circle2D": Circle2DVectorEnv, "Circle2DMuJoCo": Circle2DMuJoCoVectorEnv}
tasks = pytest.mark.parametrize("task", list(SINGLE))


class AsSingle(gym.Env):
    """The vector environment of size 1 behind the interface of a single one."""

    def __init__(self, task, **parameters):
        self.envs = VECTOR[task](1, autoreset_mode="Disabled", **parameters)
        self.observation_space = self.envs.single_observation_space
        self.action_space = self.envs.single_action_space

    def reset(self, *, seed=None, options=None):
        observation, info = self.envs.reset(seed=seed, options=options)
        return observation[0], self._floats(info)

    def step(self, action):
        observation, *values, info = self.envs.step([action])
        return observation[0], *(v.item() for v in values), self._floats(info)

    def _floats(self, info):
        return {key: np.float64(info[key][0]) for key in info if not key.startswith("_")}


@tasks
@pytest.mark.parametrize("level", LEVELS)
def test_check_env(level, task):
    check_env(gym.make(f"{task}-{level}-v0").unwrapped)
    other = gym.make(f"{task}-{level}-v0", sparse_reward=True, reset_on_cost=True)
    check_env(other.unwrapped)


@tasks
@pytest.mark.parametrize("level", LEVELS)
def test_single_matches_vector(level, task):
    single, vector = SINGLE[task](level=level), AsSingle(task, level=level)
    check_environments_match(single, vector, num_steps=300)


MODES = list(AutoresetMode)


@tasks
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("parameters", [{"level": 0}, {"level": 3, "reset_on_cost": True}])
def test_native_equals_gymnasiums_own_vector_env(mode, parameters, task):
    """Every value of 150 steps of 5 environments, bit for bit; infos but for same-step costs."""
    native = VECTOR[task](5, autoreset_mode=mode, max_episode_steps=20, **parameters)
    sync = gym.vector.SyncVectorEnv(
        [lambda: SINGLE[task](max_episode_steps=20, **parameters)] * 5, autoreset_mode=mode
    )
    assert native.observation_space == sync.observation_space
    assert native.action_space == sync.action_space
    assert native.metadata["autoreset_mode"] == sync.metadata["autoreset_mode"]
    assert data_equivalence(native.reset(seed=3), sync.reset(seed=3), exact=True)
    native.action_space.seed(0)
    ends = 0
    for _ in range(150):
        actions = np.minimum(native.action_space.sample(), 0.3)
        ours, theirs = native.step(actions), sync.step(actions)
        done = ours[2] | ours[3]
        ends += done.sum()
        if mode is AutoresetMode.SAME_STEP and done.any():
            # gymnasium gives the cost of the reset here; ours that of the step, as the reward is.
            for key in native.simulation.info_keys:
                np.testing.assert_array_equal(
                    ours[4][key][done], theirs[4]["final_info"][key][done]
                )
                theirs[4][key][done] = ours[4][key][done]
        for mine, its in zip(ours, theirs, strict=True):
            assert data_equivalence(mine, its, exact=True), (mine, its)
        if mode is AutoresetMode.DISABLED and done.any():
            results = [e.reset(options={"reset_mask": done.copy()}) for e in (native, sync)]
            assert data_equivalence(results[0][0], results[1][0], exact=True)
    assert ends > 20


def test_next_step_contract():
    envs = Circle2DVectorEnv(3, level=1, max_episode_steps=4)
    envs.reset(seed=0)
    still = np.zeros((3, 2))
    for _ in range(3):
        assert not envs.step(still)[3].any()
    last, reward, terminated, truncated, _ = envs.step(still)
    assert truncated.all()
    assert not terminated.any()
    assert (reward < 0).all()
    first, reward, terminated, truncated, info = envs.step(np.ones((3, 2)))
    assert not truncated.any()
    assert (reward == 0).all()
    assert (info["cost"] == 0).all()
    assert (np.abs(first - last).max(axis=1) > 0.01).all()
    np.testing.assert_array_equal(envs.step(still)[0], first)


def test_same_step_keeps_the_final_observation():
    envs = Circle2DVectorEnv(2, level=1, max_episode_steps=1, autoreset_mode="SameStep")
    start, _ = envs.reset(seed=0)
    observation, _, _, truncated, info = envs.step([[-1.0, 0.0], [0.0, 1.0]])
    assert truncated.all()
    final = np.stack(info["final_obs"])
    np.testing.assert_allclose(
        final - start, [[-1.1 / 15, 0], [0, 1.1 / 15]], atol=1e-6
    )  # both starts lie further than a step from the arena's edge with this seed
    assert (np.abs(observation - final).max(axis=1) > 0.01).all()


@tasks
@pytest.mark.parametrize("level", [0, 1])
def test_returned_arrays_are_fresh(level, task):
    envs = VECTOR[task](2, level=level)
    results = [envs.reset(seed=0)]
    kept = copy.deepcopy(results)
    for _ in range(12):
        results.append(envs.step(np.full((2, 2), -1.0)))
        kept.append(copy.deepcopy(results[-1]))
    assert data_equivalence(results, kept, exact=True)
    position = envs.position
    position += 100
    assert np.abs(envs.position).max() <= 15.2


@tasks
@pytest.mark.parametrize("level", [0, 2])
def test_two_seeded_runs_are_equal_and_others_are_not(level, task):
    def run(seed):
        env = gym.make(f"{task}-{level}-v0")
        env.action_space.seed(0)
        results = [env.reset(seed=seed)]
        for _ in range(50):
            results.append(env.step(env.action_space.sample()))
        results.append(env.reset())
        return results

    assert data_equivalence(run(7), run(7), exact=True)
    assert not data_equivalence(run(7)[0], run(8)[0])
    assert not data_equivalence(run(7)[0], run(7)[-1])


COPIED = [
    *SINGLE.values(),
    *(partial(make, 3) for make in VECTOR.values()),
    partial(Circle2DMuJoCoVectorEnv, 3, actuation="force", num_threads=2),
]


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
@pytest.mark.parametrize("level", [0, 3])
@pytest.mark.parametrize("make", COPIED)
def test_copies_go_on_alike(make, level, copied):
    env = make(level=level)
    env.reset(seed=1)
    for _ in range(20):
        env.step(env.action_space.sample())
    twin = copied(env)
    for _ in range(80):
        action = env.action_space.sample()
        results = env.step(action), twin.step(action)
        assert data_equivalence(*results, exact=True)
        if np.all(results[0][3]):
            assert data_equivalence(env.reset(), twin.reset(), exact=True)


@tasks
@pytest.mark.parametrize("level", [0, 1])
def test_seeds_per_environment(level, task):
    whole = VECTOR[task](4, level=level)
    start, _ = whole.reset(seed=10)
    shuffled, _ = VECTOR[task](4, level=level).reset(seed=[13, 10, 12, 11])
    np.testing.assert_array_equal(shuffled, start[[3, 0, 2, 1]])
    from_array, _ = VECTOR[task](4, level=level).reset(seed=np.arange(10, 14))
    np.testing.assert_array_equal(from_array, start)
    kept, _ = whole.reset(seed=[10, None, 12, None])
    np.testing.assert_array_equal(kept[[0, 2]], start[[0, 2]])
    assert (kept[[1, 3]] != start[[1, 3]]).any()


def test_unseeded_first_reset_follows_np_random():
    starts = []
    for _ in range(2):
        env = Circle2DVectorEnv(2, level=1)
        env.np_random = np.random.default_rng(5)
        starts.append(env.reset()[0])
    np.testing.assert_array_equal(*starts)
    assert (Circle2DVectorEnv(2, level=1).reset()[0] != starts[0]).any()


@tasks
def test_time_limit_belongs_to_make(task):
    """`make(max_episode_steps=...)` may raise and lower the limit; the class has its own."""

    def length(env):
        env.reset(seed=0)
        for steps in range(1, 200):
            *_, truncated, _ = env.step(np.zeros(env.action_space.shape))
            if np.all(truncated):
                return steps
        return None

    assert length(gym.make(f"{task}-1-v0")) == 50
    assert length(gym.make(f"{task}-1-v0", max_episode_steps=100)) == 100
    assert length(gym.make(f"{task}-1-v0", max_episode_steps=-1)) is None
    assert length(gym.make_vec(f"{task}-1-v0", num_envs=2)) == 50
    assert length(gym.make_vec(f"{task}-1-v0", num_envs=2, max_episode_steps=7)) == 7
    assert length(SINGLE[task](level=1)) == 50
    assert length(SINGLE[task](level=1, max_episode_steps=None)) is None


@pytest.mark.parametrize(
    ("action", "message"),
    [
        ([0.0], r"action must have shape \(2,\), got shape \(1,\)"),
        ([[0.0, 0.0]], r"action must have shape \(2,\), got shape \(1, 2\)"),
        ([0.0, np.nan], "action must be finite"),
        ([np.inf, 0.0], "action must be finite"),
        ([1e308, 0.0], "action must be finite, and at most 1e.150 in size"),
        (["left", "up"], "action must be numbers"),
        (["0.5", "0.5"], "action must be numbers"),
        ([0.5 + 1j, 0.5], "action must be numbers"),
        (np.array([0.5, 0.5], dtype=object), "action must be numbers"),
        (np.array(["2020-01-01", "2020-01-02"], dtype="M8[D]"), "action must be numbers"),
        ([10**400, 0.0], "action must be numbers"),
        (np.ma.masked_array([0.5, 0.5], [True, False]), "action must not be masked"),
        (None, "action must"),
    ],
)
@tasks
def test_bad_actions(action, message, task):
    env = SINGLE[task](level=1)
    env.reset(seed=0)
    before = env.position
    with pytest.raises(ValueError, match=message):
        env.step(action)
    np.testing.assert_array_equal(env.position, before)
    with pytest.raises(ValueError, match=r"action must have shape \(3, 2\), got shape \(2,\)"):
        vector = VECTOR[task](3)
        vector.reset(seed=0)
        vector.step([0.0, 0.0])


@tasks
def test_step_before_reset(task):
    for env in (SINGLE[task](level=1), VECTOR[task](2, level=1), gym.make(f"{task}-1-v0")):
        with pytest.raises(ResetNeeded, match="reset"):
            env.step(env.action_space.sample())
    mask = np.array([True, False])
    with pytest.raises(ResetNeeded, match="first reset"):
        Circle2DVectorEnv(2).reset(options={"reset_mask": mask})


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ({"start": 1}, ValueError),
        ({"reset_mask": [True, False]}, TypeError),
        ({"reset_mask": np.array([1, 0])}, TypeError),
        ({"reset_mask": np.array([True])}, ValueError),
        ({"reset_mask": np.array([False, False])}, ValueError),
    ],
)
def test_bad_reset_options(options, error):
    envs = Circle2DVectorEnv(2)
    envs.reset(seed=0)
    with pytest.raises(error, match="options"):
        envs.reset(options=options)
