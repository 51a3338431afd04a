"""Users' tasks: bounds of actions, forms of numbers, spaces, and vector environments."""

import contextlib
from dataclasses import replace
from fractions import Fraction
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from hypothesis import given, settings
from hypothesis import strategies as st
from small_runs import TRPO, steps_of
from torch import nn
from toys import Walk, registered

import agents
from agents.errors import TaskFailure, UserError
from agents.lockstep.rollout import collect
from agents.training.config import RunId, TrainConfig
from agents.training.environments import checked_spaces, make_envs, spaces_of, task_id
from agents.training.policy import Policy, _Bounded
from circle2d_mj import FromSafetyGymnasium


class Other(gym.Env):
    """Actions in [0, 4]; the cost is the int 0 in the first step, then a tenth of the action."""

    observation_space = Box(-1.0, 1.0, (3,))
    action_space = Box(0.0, 4.0, (1,))

    def __init__(self):
        self.seen = []

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.seen = []
        return np.zeros(3, np.float32), {}

    def step(self, action):
        self.seen.append(float(action[0]))
        cost = 0 if len(self.seen) == 1 else float(action[0]) / 10
        return np.zeros(3, np.float32), 0.0, False, len(self.seen) == 5, {"cost": cost}


def test_actions_are_rescaled_and_costs_stay_what_they_are():
    with registered(Other=Other):
        envs = make_envs("Other-v0", 2, {})
        assert spaces_of(["Other-v0"], {}).sizes == (3, 1)
    envs.reset(seed=[1, 2])
    assert envs.step(np.array([[0.0], [0.5]], np.float32))[4]["cost"].tolist() == [0.0, 0.0]
    costs = envs.step(np.array([[-1.0], [0.5]], np.float32))[4]["cost"]
    np.testing.assert_allclose(costs, [0.0, 0.3])  # actions 0 and 3
    np.testing.assert_allclose(envs.unwrapped.envs[1].unwrapped.seen, [3.0, 3.0])


SIDES = st.floats(-(2.0**99), 2.0**99, width=32, allow_subnormal=False)


@settings(deadline=None)
@given(st.lists(st.tuples(SIDES, SIDES).filter(lambda b: b[0] != b[1]), min_size=1, max_size=4))
def test_every_action_lies_within_the_bounds(bounds):
    """For any bounds in float32, and network outputs within [-1, 1] and beyond.

    A loaded policy sends the same actions as training.
    """
    low, high = np.sort(np.array(bounds, np.float32), axis=1).T
    space = Box(low, high)
    shares = np.array([-1.0, 1.0, 0.0, -0.3, 1 / 3, np.nextafter(1, 0), -7.0, 7.0], np.float32)
    given = np.repeat(shares[:, None], len(low), axis=1)
    of_task = type("Bounded", (Other,), {"action_space": space, "step": lambda self, a: a})
    with registered(Bounded=of_task):
        envs = make_envs("Bounded-v0", len(given), {})
    sent = envs.actions(np.clip(given, -1, 1))
    assert all(space.contains(action) for action in sent)
    np.testing.assert_array_equal(sent[:2], [low, high])
    exact = [(Fraction(float(a)) + Fraction(float(b))) / 2 for a, b in zip(low, high, strict=True)]
    np.testing.assert_allclose(sent[2], np.array(exact, np.float32), rtol=1e-6)
    spaces = checked_spaces("Bounded-v0", Other.observation_space, space)
    np.testing.assert_array_equal(policy_of(spaces, given)(np.zeros((len(given), 3))), sent)
    module = _Bounded(nn.Identity(), low, high)
    assert all(space.contains(action.numpy()) for action in module(torch.tensor(given)))


def policy_of(spaces, actions):
    """Return a policy whose network gives these actions."""
    learner = SimpleNamespace(policy=lambda: lambda observation, noise: actions[None])
    config = SimpleNamespace(task_parameters={})
    return Policy(config, RunId("Bounded-v0", 0), None, "", spaces, learner)


@pytest.mark.parametrize("dtype", [np.float16, np.float64])
@pytest.mark.parametrize("high", [1.0, 3.0])
def test_actions_have_the_type_of_the_space(dtype, high):
    space = Box(-1.0, high, (1,), dtype)
    with registered(Typed=type("Typed", (Other,), {"action_space": space})):
        envs = make_envs("Typed-v0", 1, {})
    [sent] = envs.actions(np.ones((1, 1), np.float32))
    assert space.contains(sent)
    assert sent == high


@pytest.mark.parametrize(("low", "high"), [(-np.inf, np.inf), (1.0, 1.0)])
def test_actions_must_have_bounds(low, high):
    wide = type("Wide", (Other,), {"action_space": Box(low, high, (1,))})
    with registered(Wide=wide), pytest.raises(UserError, match="must have finite bounds"):
        make_envs("Wide-v0", 2, {})


def test_ids_may_name_their_module():
    envs = make_envs("circle2d_mj:Circle2D-2-v0", 3, {})
    assert type(envs.unwrapped).__name__ == "Circle2DVectorEnv"
    with pytest.raises(UserError, match="'no_such:Circle2D-2-v0': there is no module 'no_such'"):
        task_id("no_such:Circle2D-2-v0")
    with pytest.raises(UserError, match=r"'no_such:Mine-v0' is not registered: .*--import no_such"):
        make_envs("no_such:Mine-v0", 3, {})


class InPlace(VectorEnv):
    """Episodes of five steps with the reward t in step t; every step returns the same arrays, with
    new numbers. Positions are observations."""

    single_observation_space, single_action_space = Box(-9.0, 9.0, (2,)), Box(-1.0, 1.0, (1,))
    metadata = {"autoreset_mode": AutoresetMode.DISABLED}  # noqa: RUF012

    class view:  # an attribute of the environment
        extent, axes = (-9.0, 9.0, -9.0, 9.0), ("x", "y")

        @staticmethod
        def positions(observation, info):
            return observation

        @staticmethod
        def places(positions):
            return []

    def __init__(self, num_envs=1, autoreset_mode=AutoresetMode.DISABLED):
        self.num_envs = num_envs
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.seen, self.reward = np.zeros((num_envs, 2), np.float32), np.zeros(num_envs)
        self.over, self.cost = np.zeros((2, num_envs), bool), np.zeros(num_envs)

    def reset(self, *, seed=None, options=None):
        self.seen[(options or {}).get("reset_mask", slice(None))] = 0.0
        return self.seen, {}

    def step(self, actions):
        self.seen[:, 0] += 1
        self.reward[:], self.cost[:] = self.seen[:, 0], self.seen[:, 0] % 2
        self.over[1] = self.seen[:, 0] == 5
        return self.seen, self.reward, *self.over, {"cost": self.cost}


KINDS = {
    "array of one": lambda x: np.array([x]),
    "0-d array": np.array,
    "list": lambda x: [x],
    "numpy": lambda x: np.bool_(x) if x in (0, 1) else np.float64(x),
}


@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
def test_the_types_of_rewards_costs_and_ends_do_not_matter(kind):

    class Boxed(Walk):
        def step(self, action):
            observation, *numbers, info = super().step(action)
            return observation, *map(kind, numbers), {"cost": kind(info["cost"])}

    more = TRPO | {"seeds": 0, "steps": 120}
    found = []
    for task, vectorization in ((Walk, "sync"), (Boxed, "sync"), (Boxed, "async")):
        with registered(Boxed=task):
            runs = agents.train("cpo", "Boxed-v0", vectorization=vectorization, **more)
            found.append(runs.results[0].runs[0].measures)
    assert found[1:] == found[:1] * 2


@pytest.mark.parametrize("end", [np.nan, "no", None, 2])
def test_an_end_that_is_neither_true_nor_false_is_refused(end):
    class Odd(Walk):
        def step(self, action):
            observation, reward, _, *others = super().step(action)
            return observation, reward, end, *others

    with registered(Odd=Odd), pytest.raises(UserError, match="neither True nor False"):
        agents.train("cpo", "Odd-v0", **TRPO)


class Endless(Walk):
    """A walk whose episodes never end."""

    def step(self, action):
        observation, reward, _, _, info = super().step(action)
        return observation, reward, False, False, info


def test_a_task_without_a_time_limit_is_told_how_to_get_one():
    """After 10,000 steps, in training and in the evaluation of a policy."""
    with registered(Endless=Endless):
        words = "not ended after 10000 steps: .*--task-parameters max_episode_steps"
        with pytest.raises(TaskFailure, match=words):
            agents.train("cpo", "Endless-v0", **TRPO | {"episodes": 1})
        with pytest.raises(TaskFailure, match=words):
            agents.evaluate(lambda seen: np.zeros(1, np.float32), "Endless-v0", episodes=1)
        more = {"steps": 10, "seeds": 0, "task_parameters": {"max_episode_steps": 10}}
        runs = agents.train("cpo", "Endless-v0", **TRPO | {"episodes": 1} | more)
        assert runs.records[runs.folder, 0].length.tolist() == [10]
        limit = {"max_episode_steps": 10_020}  # a user's limit may be higher
        still = agents.evaluate(lambda seen: np.zeros(1), "Endless-v0", 1, task_parameters=limit)
        assert still.lengths == 10_020
        assert replace(TrainConfig.read(runs.folder), task_parameters=limit).most_steps == 10_020


class Pieces(Walk):
    """A walk whose observation is a dict."""

    observation_space = gym.spaces.Dict({"x": Box(-9, 9, (1,)), "t": Box(0, 1, (1,))})

    def observation(self):
        return {"x": np.array([self.x], np.float32), "t": np.array([self.t / 40], np.float32)}


def test_the_error_for_a_dict_of_observations_names_the_wrapper_that_flattens():
    flat = {"Flat": lambda: gym.wrappers.FlattenObservation(Pieces())}
    with registered(Pieces=Pieces, **flat):
        with pytest.raises(UserError, match=r"FlattenObservation.*emcc\.RecordCosts"):
            agents.train("cpo", "Pieces-v0", **TRPO)
        agents.train("cpo", "Flat-v0", **TRPO | {"steps": 50, "seeds": 0})


class Single(InPlace):
    """Rewards and costs of 0.1 in float32, and episodes of 50,000 steps."""

    def step(self, actions):
        super().step(actions)
        self.over[1] = self.seen[:, 0] == 50_000
        tenths = np.full(self.num_envs, 0.1, np.float32)
        return self.seen, tenths, *self.over, {"cost": tenths}


def test_sums_of_float32_are_taken_in_float64():
    """In float32 the sum would be 5002.5."""
    exact = 50_000 * float(np.float32(0.1))
    act = lambda seen: np.zeros((2, 1), np.float32)  # noqa: E731
    rollout = collect(Single(2), [0, 1], act, most_steps=50_000)
    assert rollout.reward.dtype == rollout.cost.dtype == np.float64
    np.testing.assert_allclose(rollout.returns, exact, rtol=1e-10)
    np.testing.assert_allclose(rollout.cost_returns, exact, rtol=1e-10)


def test_a_vector_environment_may_return_the_same_arrays_in_every_step():
    with registered(InPlace=Other):
        gym.spec("InPlace-v0").vector_entry_point = InPlace
        more = {"seeds": 0, "steps": 10, "episodes": 2}
        runs = agents.train("ppo-lag", "InPlace-v0", **more)
        np.testing.assert_array_equal(runs.records[runs.folder, 0].reward, [15, 15])
        np.testing.assert_array_equal(runs.records[runs.folder, 0].cost, [3, 3])
        assert set(runs.to_pandas("evaluations")["return"]) == {15}
        positions = steps_of(runs.folder, "InPlace-v0/0", "positions")
        np.testing.assert_array_equal(positions[:, 0], [1, 2, 3, 4, 5] * 2)


class Silent(InPlace):
    """From the third step on, environment 1 gives no cost; Gymnasium fills in 0."""

    def step(self, actions):
        *values, info = super().step(actions)
        gave = (self.seen[:, 0] < 3) | (np.arange(self.num_envs) != 1)
        return *values, info | {"cost": np.where(gave, self.cost, 0.0), "_cost": gave}


class SelfResetting(InPlace):
    metadata = {"autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012


def test_a_vector_environment_must_give_each_cost_and_not_reset_itself():
    for name, vector in (("Silent-v0", Silent), ("Resetting-v0", SelfResetting)):
        gym.register(name, vector_entry_point=vector)
    try:
        with contextlib.closing(make_envs("Silent-v0", 2, {})) as envs:
            played = collect(envs, [0, 1], lambda seen: np.zeros((2, 1), np.float32))
        assert played.failure.tolist() == ["", "cost"]
        with pytest.raises(UserError, match="'Resetting-v0' must not reset itself"):
            make_envs("Resetting-v0", 2, {})
    finally:
        gym.registry.pop("Silent-v0"), gym.registry.pop("Resetting-v0")


class Forgetful(InPlace):
    """Episodes of five, six, ... steps side by side; resetting one environment resets all."""

    def reset(self, *, seed=None, options=None):
        return super().reset(seed=seed)

    def step(self, actions):
        super().step(actions)
        self.over[1] = self.seen[:, 0] == 5 + np.arange(self.num_envs)
        return self.seen.copy(), self.reward, *self.over, {"cost": self.cost}


def test_a_vector_environment_that_resets_others_is_refused():
    """Otherwise episodes would be recorded that were reset in the middle."""
    with registered(Forgetful=Other):
        gym.spec("Forgetful-v0").vector_entry_point = Forgetful
        words = r"a reset of task 'Forgetful-v0' with options\['reset_mask'\] changes environments"
        with pytest.raises(TaskFailure, match=words):
            agents.train("ppo-lag", "Forgetful-v0", seeds=0, steps=10, episodes=2)


class Six(Walk):
    """Returns the cost between reward and ends, as Safety-Gymnasium's tasks do."""

    def step(self, action):
        observation, reward, *ends, info = super().step(action)
        return observation, reward, info["cost"], *ends, {}


@pytest.mark.parametrize("limit", [None, 30])
def test_the_error_for_steps_of_six_values_names_the_wrapper(limit):
    """With and without gymnasium's time limit, whose own error differs."""
    own = {"Six": Six, "Five": lambda: FromSafetyGymnasium(Six())}
    more = TRPO | {"steps": 50, "seeds": 0}
    with registered(**own):
        for name in own:
            gym.spec(f"{name}-v0").max_episode_steps = limit
        with pytest.raises(UserError, match=r"six values: .*circle2d_mj\.FromSafetyGymnasium"):
            agents.train("cpo", "Six-v0", **more)
        agents.train("cpo", "Five-v0", **more)
