"""Sauté's budget and reward, against OmniSafe's adapter and by hand; its observations and its
records."""

from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from small_trainings import of_run, small, trainer
from toys import register

import agents
from agents.algorithms import algorithm
from agents.errors import UserError
from agents.lockstep.rollout import Rollout, learned
from agents.reporting.pictures import evaluation_episodes
from agents.training.config import TrainConfig
from agents.training.environments import make_envs
from agents.training.evaluation import evaluate_runs

register()
NAMES = ("ppo-saute", "trpo-saute")
COSTS, REWARDS = [1.0, 0.0, 2.0, 0.0, 1.0, 1.0], [0.5, 0.25, -1.0, 2.0, 3.0, 4.0]
OMNISAFE = [0.6368438, 0.7076042, -0.1623078, -0.1803420, -0.6746473, -1.2238754]
"""Observations of OmniSafe 0.5.0's `SauteAdapter` after steps with these costs, for a budget of 3,
six steps and saute_gamma .9. Its rewards are the task's in the first two steps, then -1."""


class Given(gym.Env):
    """An episode of these costs and rewards."""

    observation_space = gym.spaces.Box(-1, 1, (1,))
    action_space = gym.spaces.Box(-1, 1, (1,))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.t = 0
        return np.zeros(1, np.float32), {}

    def step(self, action):
        t, self.t = self.t, self.t + 1
        return np.zeros(1, np.float32), REWARDS[t], False, self.t == 6, {"cost": COSTS[t]}


def saute(**changes):
    return algorithm("ppo-saute").config(cost_limit=3.0, saute_discount=0.9, **changes)


def left(env):
    observation, _ = env.reset()
    assert observation.tolist() == [0, 1]
    return [env.step(np.zeros(1, np.float32))[0][-1] for _ in range(6)]


def test_the_discounted_budget_is_omnisafes():
    np.testing.assert_allclose(left(saute().wrap(Given(), ("cost",), 6)), OMNISAFE, rtol=1e-6)


def test_without_a_discount_it_is_what_is_left_of_the_limit():
    """(3 - 1, 1, 3, 3, 4, 5) / 3, whatever the length of an episode."""
    found = left(replace(saute(), saute_discount=1.0).wrap(Given(), ("cost",), None))
    np.testing.assert_allclose(found, [2 / 3, 2 / 3, 0, 0, -1 / 3, -2 / 3], atol=1e-7)


def test_a_spent_budget_replaces_the_reward():
    """A budget of 0 is spent, also where rounding leaves 1e-16 of it (1 - 3 times 1/3); OmniSafe,
    too, keeps the reward only where z > 0."""
    after = np.array([0.5, 1e-16, 0.0, -1.0], np.float32)
    numbers = np.zeros((4, 1, 2), np.float32)
    following = np.stack([np.zeros(4), after], axis=-1)[:, None].astype(np.float32)
    ends = np.zeros((4, 1), bool)
    reward, cost = np.arange(4.0)[:, None], np.ones((4, 1, 1))
    given = (numbers, numbers, reward, cost, following, ends, ends, np.array([4]), np.array([""]))
    rollout = Rollout._make(given)
    assert learned(rollout, saute(unsafe_reward=-7.0), 1).reward.ravel().tolist() == [0, -7, -7, -7]


@pytest.mark.parametrize("name", NAMES)
def test_policies_see_the_budget_and_records_keep_the_task(name, tmp_path):
    """The recorded returns are the task's own, which the algorithm does not learn from."""
    config = TrainConfig(name, ("Circle2D-1-v0",), (0, 1), 300, small(name, saute_discount=0.99))
    it = trainer(config, tmp_path / "run")
    seen = {}
    learn = it.learner.learn
    it.learner.learn = lambda rollout, *rest: learn(seen.setdefault("first", rollout), *rest)
    it.run_epoch()
    rollout = seen["first"]
    assert rollout.observation.shape[-1] == 3 and (rollout.observation[0, :, -1] == 1).all()
    gamma, after = 0.99, rollout.next_observation[..., -1]
    budget = 1.0 * (1 - gamma**50) / (1 - gamma) / 50
    spent = np.cumsum(rollout.cost[..., 0] * gamma ** np.arange(50)[:, None], axis=0)
    expected = (1 - spent / budget) / gamma ** np.arange(1, 51)[:, None]
    np.testing.assert_allclose(after, expected, rtol=1e-4, atol=1e-4)
    assert (after <= 0).any() and (after > 0).any()
    sums = rollout.reward.sum(axis=0)
    np.testing.assert_allclose(of_run(it, 0)["return"], sums[:3])
    assert (it.learner.config.relabelled(rollout).reward.sum(axis=0) != sums).any()


def test_loaded_policies_evaluations_and_films_see_the_budget(tmp_path):
    """An evaluation gives the returns of the one at the end of training, and a policy can be used
    in environments that it wraps."""
    options = {"steps": 200, "seeds": 0, "episodes": 2, "hidden": (8,), "evaluation_episodes": 4}
    runs = agents.train("ppo-saute", "Circle2D-1-v0", out=tmp_path / "run", **options)
    policy = agents.load_policy(runs.folder)
    found = agents.evaluate(policy, episodes=4)
    assert found.lengths.tolist() == [50] * 4
    with pytest.raises(ValueError, match=r"observation must be \[3\]"):
        policy([0.1, 0.2])
    env, envs = policy.wrap(gym.make("Circle2D-1-v0")), make_envs("Circle2D-1-v0", 2, {})
    assert policy(env.reset(seed=0)[0]).shape == policy(policy.wrap(envs).reset()[0])[0].shape
    assert policy.to_torch() is not None
    run = runs.config.runs[0]
    for own_frames in (False, True):
        episodes, _ = evaluation_episodes(Path(runs.folder), run, 1, False, own_frames)
        assert len(episodes[0].costs) == 50
    again = evaluate_runs(runs.config, policy.in_lockstep, 4)["deterministic"]
    kept = dict(np.load(runs.folder / "results.npz"))
    own = kept["Circle2D-1-v0/0/evaluation/deterministic/returns"]
    assert again.returns[0].tolist()[: len(own)] == own.tolist()


@pytest.mark.parametrize("poisons", ["cost", "negative", "observation"])
def test_a_tasks_wrong_numbers_are_named_beneath_the_wrapper(poisons):
    config = TrainConfig("ppo-saute", ("Walk-v0",), (0, 1), 400, small("ppo-saute"))
    config = replace(config, task_parameters={"poison": 0.02, "poisons": poisons})
    it = trainer(config)
    while not (it.failures != "").any():
        it.run_epoch()
    named = {"cost": "its cost is", "negative": "a negative cost", "observation": "its observation"}
    assert all(named[poisons] in failure for failure in it.failures if failure)


def test_settings_that_are_not_allowed(tmp_path):
    for name in NAMES:
        config = algorithm(name).config
        with pytest.raises(UserError, match="cost_limit must be above 0 with Sauté"):
            config(cost_limit=0.0)
        with pytest.raises(UserError, match=r"streak_weight must be 0 with Sauté, got 0\.5"):
            config(streak_weight=0.5)
    with pytest.raises(UserError, match=r"saute_discount 0\.999 needs a task with a time limit"):
        agents.train("ppo-saute", "Walk-v0", out=tmp_path / "x")
