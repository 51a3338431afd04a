"""The contract of every task: gymnasium's checks and vector environments, seeds, copies, states,
errors; the random streams against the reference."""

import copy
import pickle
from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from circle2d_mj import Circle2DEnv, Circle2DVectorEnv
from circle2d_mj.circle2d.mujoco_envs import Circle2DMuJoCoEnv, Circle2DMuJoCoVectorEnv
from circle2d_mj.core.streams import Streams, keys_of_seeds, philox
from circle2d_mj.safety.envs import SafetyEnv, SafetyVectorEnv
from circle2d_mj.safety_gymnasium.vector import SafetySyncVectorEnv

# Safety tasks of each kind of state: free objects, gremlins and timers, a box, no objects, other
# robots, bodies without and with observed forces.
SAFETY = ["SafetyPointGoal2", "SafetyCarButton1", "SafetyPointPush1", "SafetyCarCircle2"]
SAFETY += ["SafetyRacecarPush1", "SafetyAntGoal1"]
SAFETY += ["SafetyHopperVelocity", "SafetyHumanoidVelocity"]
KINEMATIC = (Circle2DEnv, Circle2DVectorEnv)
PHYSICS = (Circle2DMuJoCoEnv, Circle2DMuJoCoVectorEnv)
TASKS = {
    "kinematic rigid": (*KINEMATIC, {"level": 0}),
    "kinematic": (*KINEMATIC, {"level": 3, "reset_on_cost": True}),
    "rigid": (*PHYSICS, {"level": 0}),
    "open": (*PHYSICS, {"level": 3, "reset_on_cost": True, "actuation": "force"}),
    "soft": (*PHYSICS, {"level": 1, "contact": "soft", "randomize": {"mass": (0.5, 2.0)}}),
}
TASKS |= {name: (partial(SafetyEnv, name), partial(SafetyVectorEnv, name), {}) for name in SAFETY}
VECTOR = [Circle2DVectorEnv, Circle2DMuJoCoVectorEnv, partial(SafetyVectorEnv, "SafetyPointGoal1")]
tasks = pytest.mark.parametrize("task", TASKS)
equal = np.testing.assert_array_equal


def single(task, steps=12):
    return TASKS[task][0](max_episode_steps=steps, **TASKS[task][2])


def vector(task, n, steps=12, **options):
    return TASKS[task][1](n, max_episode_steps=steps, **TASKS[task][2], **options)


def action_of(env):
    """Draw actions, few of them to the right, so that agents come into the region."""
    return np.minimum(env.action_space.sample(), 0.3)


def assert_alike(mine, its):
    assert data_equivalence(mine, its, exact=True), (mine, its)


@pytest.mark.parametrize("task", [task for task in TASKS if task not in SAFETY])
def test_gymnasiums_checks(task):
    """For the Safety tasks see test_envs.py."""
    env = single(task)
    check_env(env, skip_render_check=True)
    for info in (env.reset(seed=0)[1], env.step(np.zeros(2))[4]):
        assert "cost" in info
        assert all(
            isinstance(value, float) and value.dtype == np.float64 for value in info.values()
        )


OF_STATES = {"x_position", "y_position", "distance_from_origin", "mass"}
# The same-step mode with every task; the others, whose code is common to all tasks, with three.
MODES = [(task, AutoresetMode.SAME_STEP) for task in TASKS]
MODES += [
    (task, mode)
    for task in ("kinematic", "open", "SafetyCarButton1")
    for mode in (AutoresetMode.NEXT_STEP, AutoresetMode.DISABLED)
]


@pytest.mark.parametrize(("task", "mode"), MODES)
def test_native_equals_gymnasiums_own_vector_env(task, mode):
    """Every value of 40 steps of 5 environments, bit for bit, except costs in same-step infos.

    Positions and drawn masses in the info belong to the observed state, as gymnasium's do.
    """
    native = vector(task, 5, autoreset_mode=mode)
    sync = SyncVectorEnv([lambda: single(task)] * 5, autoreset_mode=mode)
    assert native.observation_space == sync.observation_space
    assert native.action_space == sync.action_space
    assert native.metadata["autoreset_mode"] == sync.metadata["autoreset_mode"]
    assert_alike(native.reset(seed=3), sync.reset(seed=3))
    native.action_space.seed(0)
    ends = 0
    for _ in range(40):
        actions = action_of(native)
        ours, theirs = native.step(actions), sync.step(actions)
        done = ours[2] | ours[3]
        ends += done.sum()
        if mode is AutoresetMode.SAME_STEP and done.any():
            # gymnasium gives the infos of the reset here; ours are of the step, like the reward.
            for key in set(native.simulation.info_keys) - OF_STATES:
                final = theirs[4]["final_info"].get(key, np.zeros(5))[done]
                equal(ours[4][key][done], final)
                theirs[4][key] = np.where(done, ours[4][key], theirs[4][key])
        for mine, its in zip(ours, theirs, strict=True):
            assert_alike(mine, its)
        if mode is AutoresetMode.DISABLED and done.any():
            results = [e.reset(options={"reset_mask": done.copy()}) for e in (native, sync)]
            assert_alike(results[0][0], results[1][0])
    assert ends >= 15


@tasks
def test_ended_neighbours_need_no_reset(task):
    """Without autoreset, copies whose episodes go on do not depend, bit for bit, on whether the
    others were reset."""
    envs, alone = (vector(task, 5, steps=30, autoreset_mode="Disabled") for _ in range(2))
    equal(envs.reset(seed=3)[0], alone.reset(seed=3)[0])
    running = np.ones(5, dtype=bool)
    for _ in range(30):
        actions = action_of(envs)
        mine, its = envs.step(actions), alone.step(actions)
        for a, b in zip(mine[:4], its[:4], strict=True):
            equal(a[running], b[running])
        running &= ~(mine[2] | mine[3])
        if not running.all():
            alone.reset(options={"reset_mask": ~running})
    assert not running.any()
    envs.step(actions)  # a step of ended copies alone
    equal(envs.reset(seed=3)[0], alone.reset(seed=3)[0])


@tasks
def test_neighbours_and_threads_change_nothing(task):
    """Environment i of 40, on two threads, is environment i of 3, bit for bit."""
    threads = {} if "kinematic" in task else {"num_threads": 2}
    few, many = vector(task, 3, steps=30), vector(task, 40, steps=30, **threads)
    equal(few.reset(seed=7)[0], many.reset(seed=7)[0][:3])
    many.action_space.seed(0)
    for _ in range(40):
        actions = action_of(many)
        mine, its = few.step(actions[:3]), many.step(actions)
        for a, b in zip(mine[:4], its[:4], strict=True):
            equal(a, b[:3])
        for key in mine[4]:
            equal(mine[4][key], its[4][key][:3])


@tasks
def test_each_environment_has_its_own_seed(task):
    whole = vector(task, 4)
    start, _ = whole.reset(seed=10)
    equal(vector(task, 4).reset(seed=[13, 10, 12, 11])[0], start[[3, 0, 2, 1]])
    equal(vector(task, 4).reset(seed=np.arange(10, 14))[0], start)
    kept, _ = whole.reset(seed=[10, None, 12, None])
    equal(kept[[0, 2]], start[[0, 2]])
    assert (kept[[1, 3]] != start[[1, 3]]).any()


@tasks
def test_copies_go_on_alike_and_apart(task):
    for env in (single(task), vector(task, 3)):
        env.reset(seed=1)
        for _ in range(5):
            env.step(action_of(env))
        twin, other = copy.deepcopy(pickle.loads(pickle.dumps(env))), copy.deepcopy(env)
        other.step(-np.ones(env.action_space.shape))
        for _ in range(30):
            action = action_of(env)
            results = env.step(action), twin.step(action)
            assert_alike(*results)
            if np.all(results[0][2] | results[0][3]):
                assert_alike(env.reset(), twin.reset())


@tasks
def test_state_and_restore(task):
    """A state is restored into a used environment and into one that was never reset; resets and
    new goals follow alike."""
    env, used, new = (vector(task, 4, steps=30) for _ in range(3))
    env.reset(seed=5)
    used.reset(seed=99)
    for _ in range(40):
        env.step(action_of(env))
        used.step(action_of(env))
    state = env.state_dict()
    assert all(len(array) == 4 for array in state.values())
    kept = copy.deepcopy(state)
    for other in (used, new):
        other.load_state_dict(state)
    for _ in range(40):
        action = action_of(env)
        results = [e.step(action) for e in (env, used, new)]
        assert_alike(results[0], results[1])
        assert_alike(results[0], results[2])
    assert_alike(state, kept)  # neither stepping nor restoring changed it


@tasks
def test_returned_arrays_are_fresh(task):
    envs = vector(task, 2)
    results = [envs.reset(seed=0)]
    kept = copy.deepcopy(results)
    for _ in range(14):
        results.append(envs.step(-np.ones(envs.action_space.shape)))
        kept.append(copy.deepcopy(results[-1]))
    assert_alike(results, kept)


def test_unseeded_first_reset_follows_np_random():
    starts = []
    for _ in range(2):
        env = Circle2DVectorEnv(2, level=1)
        env.np_random = np.random.default_rng(5)
        starts.append(env.reset()[0])
    equal(*starts)
    assert (Circle2DVectorEnv(2, level=1).reset()[0] != starts[0]).any()


@pytest.mark.parametrize("name", ["Circle2D-1-v0", "Circle2DMuJoCo-1-v0"])
def test_make_sets_the_time_limit(name):
    """`make(max_episode_steps=...)` raises or removes the limit; the class has one as well."""

    def length(env):
        env.reset(seed=0)
        for steps in range(1, 200):
            *_, truncated, _ = env.step(np.zeros(env.action_space.shape))
            if np.all(truncated):
                return steps
        return None

    for options, expected in (({}, 50), ({"max_episode_steps": 100}, 100)):
        assert length(gym.make(name, **options)) == expected
        assert length(gym.make_vec(name, num_envs=2, **options)) == expected
    assert length(gym.make(name, max_episode_steps=-1)) is None
    own = type(gym.make(name).unwrapped)
    assert length(own(level=1)) == 50
    assert length(own(level=1, max_episode_steps=None)) is None


MASKED = np.ma.masked_array([0.5, 0.5], [True, False])
BAD_ACTIONS = [
    [0.0], [[0.0, 0.0]], [0.0, np.nan], [np.inf, 0.0], [1e308, 0.0], ["0.5", "0.5"],
    [0.5 + 1j, 0.5], np.array([0.5, 0.5], dtype=object), np.zeros(2, "M8[D]"), [10**400, 0.0],
    MASKED, None,
]  # fmt: skip


@pytest.mark.parametrize("action", BAD_ACTIONS, ids=repr)
def test_bad_actions_are_named_and_change_nothing(action):
    env, twin = single("kinematic"), single("kinematic")
    env.reset(seed=0)
    twin.reset(seed=0)
    with pytest.raises(ValueError, match="action must"):
        env.step(action)
    assert_alike(env.step(np.ones(2)), twin.step(np.ones(2)))
    envs = vector("kinematic", 3)
    envs.reset(seed=0)
    with pytest.raises(ValueError, match=r"action must have shape \(3, 2\), got shape \(2,\)"):
        envs.step([0.0, 0.0])
    with pytest.raises(ValueError, match="action must not be masked"):
        envs.step([[0.5, 0.5], [0.5, 0.5], MASKED])  # numpy would drop the mask


def test_step_before_reset():
    for env in (single("kinematic"), vector("kinematic", 2)):
        with pytest.raises(ResetNeeded, match="reset"):
            env.step(env.action_space.sample())
    with pytest.raises(ResetNeeded, match="first reset"):
        vector("kinematic", 2).reset(options={"reset_mask": np.array([True, False])})


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ({"start": 1}, ValueError),
        ({"reset_mask": [True, False]}, TypeError),
        ({"reset_mask": np.array([True])}, ValueError),
        ({"reset_mask": np.array([False, False])}, ValueError),
    ],
)
def test_bad_reset_options_are_named(options, error):
    envs = Circle2DVectorEnv(2)
    envs.reset(seed=0)
    with pytest.raises(error, match="options"):
        envs.reset(options=options)


WRONG_ARGUMENTS = {"num_envs": (0, 1.5), "num_threads": (-1, True), "max_episode_steps": (0,)}
WRONG_ARGUMENTS |= {"render_mode": ("ansi",), "autoreset_mode": ("Never",)}


@pytest.mark.parametrize("make", VECTOR)
@pytest.mark.parametrize(
    ("name", "value"), [(name, value) for name, of in WRONG_ARGUMENTS.items() for value in of]
)
def test_bad_arguments_are_named(make, name, value):
    if name == "num_threads" and make is Circle2DVectorEnv:
        pytest.skip("it has no threads")
    with pytest.raises((TypeError, ValueError), match="Never" if value == "Never" else name):
        make(**{"max_episode_steps": None, name: value})


@pytest.mark.parametrize("cls", [Circle2DVectorEnv, SafetyVectorEnv, SafetySyncVectorEnv])
def test_an_environment_whose_constructor_failed_can_be_closed(cls):
    """gymnasium before 1.3 closes it when it is deleted, and prints any error."""
    cls.__new__(cls).close()


def scalar_philox(key, counter):
    """Philox in plain integers, written from the paper (Salmon et al. 2011)."""
    k = [key % 2**32, key >> 32]
    c = [counter % 2**32, counter >> 32, 0, 0]
    for _ in range(10):
        a, b = 0xD2511F53 * c[0], 0xCD9E8D57 * c[2]
        c = [(b >> 32) ^ c[1] ^ k[0], b % 2**32, (a >> 32) ^ c[3] ^ k[1], a % 2**32]
        k = [(k[0] + 0x9E3779B9) % 2**32, (k[1] + 0xBB67AE85) % 2**32]
    return c


def test_philox_against_plain_integers():
    """These are checked against the reference implementation (Random123, file kat_vectors)."""
    assert scalar_philox(0, 0) == [0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8]
    rng = np.random.default_rng(0)
    keys, counters = rng.integers(2**64, size=(2, 200), dtype=np.uint64)
    expected = [scalar_philox(int(k), int(c)) for k, c in zip(keys, counters, strict=True)]
    np.testing.assert_array_equal(philox(keys, counters), np.array(expected, dtype=np.uint64))


def test_several_draws_equal_as_many_calls():
    once, often = (Streams(np.arange(5, dtype=np.uint64)) for _ in range(2))
    index = np.array([3, 1])
    calls = [often.uniform(index) for _ in range(3)]
    np.testing.assert_array_equal(once.uniform(index, draws=3), np.hstack(calls))
    np.testing.assert_array_equal(once.uniform(index), often.uniform(index))
    np.testing.assert_array_equal(once.counters, often.counters)


def test_draws_are_uniform_and_uncorrelated():
    draws = Streams(np.arange(50_000, dtype=np.uint64)).uniform(np.arange(50_000))
    assert (draws > 0).all()
    assert (draws < 1).all()
    np.testing.assert_allclose(draws.mean(axis=0), 0.5, atol=0.01)
    np.testing.assert_allclose(np.corrcoef(draws.T), np.eye(4), atol=0.02)


NO_SEEDS = [("1", TypeError, "seed must be an integer or a sequence of integers, got '1'")]
NO_SEEDS += [(seed, TypeError, "seed must be an integer") for seed in (1.5, [1, 2.5], True)]
NO_SEEDS += [(-1, ValueError, r"seed must be in \[0, 2\*\*64\), got -1")]
NO_SEEDS += [(2**64 - 1, ValueError, "seed must be in")]
NO_SEEDS += [([1, 2, 3], ValueError, r"one entry per environment \(2\)")]


@pytest.mark.parametrize(("seed", "error", "message"), NO_SEEDS)
def test_bad_seeds_are_named(seed, error, message):
    with pytest.raises(error, match=message):
        keys_of_seeds(seed, 2)
