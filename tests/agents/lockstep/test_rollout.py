"""Rollouts of episodes of different lengths against scripted environments; the scaled observations
and streak costs that algorithms learn from."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from small_trainings import trained as in_full
from toys import Walk, register

import agents
from agents.algorithms import algorithm
from agents.errors import TaskFailure, UserError
from agents.lockstep.rollout import collect, learned, streaks
from agents.training.wrappers import SideBySide
from emcc import StreakCost


class Countdown(gym.Env):
    """An episode of `seed` steps: the observation is the number of steps taken, t, and the reward
    10 + t. The costs are "cost", t, and "jerk", 2 where t is even."""

    observation_space = Box(-np.inf, np.inf, (1,))
    action_space = Box(-1.0, 1.0, (1,))

    def __init__(self, truncates=False, gives_cost=True):
        self.truncates, self.gives_cost = truncates, gives_cost

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.length, self.t = seed or 3, 0
        return np.zeros(1, np.float32), {}

    def step(self, action):
        assert self.t < self.length, "stepped beyond its end"
        self.t += 1
        end = self.t == self.length
        info = {"cost": float(self.t), "jerk": 2.0 * (self.t % 2 == 0)} if self.gives_cost else {}
        observation = np.full(1, self.t, np.float32)
        return observation, 10.0 + self.t, end and not self.truncates, end and self.truncates, info


def scripted(**kwargs):
    return SyncVectorEnv([lambda: Countdown(**kwargs)] * 3, autoreset_mode=AutoresetMode.DISABLED)


def test_two_vector_environments_side_by_side_give_what_each_gives_alone():
    """The scripted environments refuse steps beyond the end of an episode."""
    parts = [scripted(), scripted(truncates=True)]
    seeds, active = [2, 7, 4, 3, 3, 9], np.array([True] * 5 + [False])
    rollout = collect(SideBySide(parts, ("cost",)), seeds, lambda obs: -0.1 * obs, active)
    assert rollout.length.tolist() == [2, 7, 4, 3, 3, 0]
    for k, truncates in enumerate((False, True)):
        own = slice(3 * k, 3 * k + 3)
        envs = scripted(truncates=truncates)
        alone = collect(envs, seeds[own], lambda obs: -0.1 * obs, active[own])
        of_part, during = rollout.of(own), alone.during
        np.testing.assert_array_equal(of_part.length, alone.length)
        for ours, theirs in zip(of_part[:7], alone[:7], strict=True):
            np.testing.assert_array_equal(ours[: len(during)][during], theirs[during])
    silent = SideBySide([scripted(), scripted(gives_cost=False)], ("cost",))
    with pytest.raises(UserError, match="gives no info"):
        collect(silent, seeds, lambda obs: obs)


@pytest.mark.parametrize("truncates", [False, True])
def test_lengths_sums_and_ends(truncates):
    envs = scripted(truncates=truncates)
    rollout = collect(envs, [2, 7, 4], lambda obs: -0.1 * obs, costs=("cost", "jerk"))
    assert rollout.length.tolist() == [2, 7, 4]
    # Returns Σ (10 + t) = 10 n + n (n + 1) / 2: 23, 98, 50. Costs Σ t: 3, 28, 10; and 2 for each
    # even number up to n, of which there are 1, 3, 2.
    assert rollout.returns.tolist() == [23.0, 98.0, 50.0]
    assert rollout.cost_returns.tolist() == [[3.0, 2.0], [28.0, 6.0], [10.0, 4.0]]
    ends = rollout.truncated if truncates else rollout.terminated
    other = rollout.terminated if truncates else rollout.truncated
    for run, n in enumerate(rollout.length):
        assert ends[:n, run].tolist() == [False] * (n - 1) + [True]
        assert not other[:n, run].any()
        np.testing.assert_array_equal(rollout.observation[:n, run, 0], np.arange(n))
        np.testing.assert_array_equal(rollout.next_observation[:n, run, 0], 1 + np.arange(n))
        np.testing.assert_allclose(rollout.action[:n, run, 0], -0.1 * np.arange(n), rtol=1e-6)


@pytest.mark.parametrize("bad", ["action", "observation", "start", "reward", "jerk"])
def test_an_episode_with_a_number_that_is_not_finite_is_void_and_says_which(bad):
    """It occurs in the second step of the second of three episodes; the others do not change."""

    class Bad(Countdown):
        def reset(self, **options):
            observation, info = super().reset(**options)
            return observation * (np.nan if bad == "start" and self.length == 7 else 1), info

        def step(self, action):
            observation, reward, *ends, info = super().step(action)
            if self.length == 7 and self.t == 2:
                observation = observation * (np.nan if bad == "observation" else 1)
                reward = np.inf if bad == "reward" else reward
                info["jerk"] = np.nan if bad == "jerk" else info["jerk"]
            return observation, reward, *ends, info

    def act(observation):
        chosen = -0.1 * observation
        chosen[1] = np.nan if bad == "action" and observation[1] == 1 else chosen[1]
        return chosen

    envs = SyncVectorEnv([Bad] * 3, autoreset_mode=AutoresetMode.DISABLED)
    found = collect(envs, [2, 7, 4], act, costs=("cost", "jerk"))
    plain = collect(scripted(), [2, 7, 4], lambda obs: -0.1 * obs, costs=("cost", "jerk"))
    assert found.failure.tolist() == ["", "observation" if bad == "start" else bad, ""]
    assert found.diverged.tolist() == [False, True, False]
    for run in (0, 2):
        for ours, theirs in zip(found[:7], plain[:7], strict=True):
            end = plain.length[run]
            np.testing.assert_array_equal(ours[:end, run], theirs[:end, run])


def test_actions_are_kept_as_chosen_and_taken_clipped():
    taken = []

    class Noted(Countdown):
        def step(self, action):
            taken.append(float(action[0]))
            return super().step(action)

    envs = SyncVectorEnv([Noted], autoreset_mode=AutoresetMode.DISABLED)
    rollout = collect(envs, [3], lambda observation: observation - 1.5)
    assert rollout.action.ravel().tolist() == [-1.5, -0.5, 0.5]
    assert taken == [-1.0, -0.5, 0.5]


def test_an_episode_that_never_ends_is_an_error():
    how = {"act": lambda observation: observation, "most_steps": 6}
    assert collect(scripted(), [2, 6, 4], **how).length.max() == 6
    with pytest.raises(TaskFailure, match=r"has not ended after 6 steps: .* max_episode_steps"):
        collect(scripted(), [2, 7, 4], **how)


register()

FAMILIES = ("trpo-lag", "ppo-lag", "sac-lb")


def trained(name, **settings):
    return in_full(name, steps=200, **settings)


def test_streaks_by_hand():
    costs = np.array([[1.0, 0.0], [1.0, 2.0], [0.0, 0.1], [1.0, 2.0]])
    np.testing.assert_array_equal(streaks(costs), [[1, 0], [2, 1], [0, 2], [1, 3]])


def test_costs_and_observations_are_those_of_the_wrapper():
    """On episodes of different lengths, against `emcc.StreakCost` around each environment.

    A second cost has a streak of its own, whatever the factor between both costs.
    """

    def episodes(wrap):
        makers = [lambda: wrap(gym.wrappers.TimeLimit(Walk(), 40))] * 6
        envs = SyncVectorEnv(makers, autoreset_mode=AutoresetMode.DISABLED)
        return collect(envs, range(6), lambda observation: np.full((6, 1), 0.6, np.float32))

    plain = episodes(lambda env: env)
    expected = episodes(lambda env: StreakCost(env, 0.25, scale=1.0))
    config = algorithm("sac-lb").config(streak_weight=0.25)
    of_rollout, during = learned(plain, config, 1), plain.during
    assert (plain.cost[during] != expected.cost[during]).any()
    for name in ("cost", "observation", "next_observation", "reward"):
        found, by_wrapper = (getattr(rollout, name)[during] for rollout in (of_rollout, expected))
        np.testing.assert_array_equal(found, by_wrapper, err_msg=name)
    shifted = np.roll(plain.cost, 3, axis=0)
    both = plain._replace(cost=np.concatenate([3.0 * shifted, plain.cost], axis=-1))
    assert learned(both, config, 1).cost.shape[-1] == 1
    both = learned(both, config, 2)
    np.testing.assert_array_equal(both.cost[..., 1], of_rollout.cost[..., 0])
    np.testing.assert_array_equal(both.observation[..., 3], of_rollout.observation[..., 2])
    alone = learned(plain._replace(cost=3.0 * shifted), config, 1)
    np.testing.assert_array_equal(both.cost[..., 0], alone.cost[..., 0])
    np.testing.assert_array_equal(both.observation[..., :3], alone.observation)


@pytest.mark.parametrize("name", FAMILIES)
def test_the_critics_alone_see_the_streak_and_records_keep_the_plain_cost(name):
    """The critics have one more input, the policy has none. The recorded costs of Walk's steps are
    0 or 1, whatever cost is learned."""
    both = [trained(name, streak_weight=w) for w in (0.0, 3.0)]
    plain, of_streaks = (it.learner for it in both)
    assert of_streaks.nets.critic.sizes[0] == plain.nets.critic.sizes[0] + 1
    actors = [learner.state_dict()["actor"] for learner in (plain, of_streaks)]
    assert actors[0].shape == actors[1].shape
    assert (actors[0] != actors[1]).any()
    recorded = [it.recorder.take()["Walk-v0/0/costs/cost"] for it in both]
    assert {*np.concatenate(recorded)} == {0.0, 1.0}


@pytest.mark.parametrize(
    ("name", "scale"), [("trpo-lag", 16.0), ("ppo-lag", (16.0, 0.5)), ("sac-lb", (16.0, 0.5))]
)
def test_an_input_scale_trains_as_a_task_with_scaled_observations(name, scale):
    """Bit for bit, since multiplying by a power of two changes the exponent alone."""
    inside = trained(name, input_scale=scale)
    outside = trained(name, parameters={"scale": scale})
    expected = outside.learner.state_dict()
    for key, value in inside.learner.state_dict().items():
        np.testing.assert_array_equal(value, expected[key], err_msg=key)
    if scale == 16.0:
        assert (trained(name).learner.state_dict()["actor"] != expected["actor"]).any()


def test_input_scales_must_be_as_many_as_the_observations_numbers(tmp_path):
    with pytest.raises(agents.UserError, match=r"input_scale .* 2, .*got \(1.0, 2.0, 3.0\)"):
        agents.train("cpo", "Walk-v0", seeds=[0], out=tmp_path, input_scale=[1.0, 2.0, 3.0])
    assert not list(tmp_path.iterdir())
