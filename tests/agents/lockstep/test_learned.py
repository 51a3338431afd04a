"""Rollouts as algorithms learn from them: scaled observations, costs that grow along a streak."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from small_trainings import trained as in_full
from toys import Walk, register

import agents
from agents.algorithms import algorithm
from agents.lockstep.rollout import collect, learned, streaks
from emcc import StreakCost

register()

FAMILIES = ("trpo-lag", "ppo-lag", "sac-lb")


def trained(name, **settings):
    return in_full(name, steps=200, **settings)


def test_streaks_by_hand():
    costs = np.array([[1.0, 0.0], [1.0, 2.0], [0.0, 0.1], [1.0, 2.0]])
    np.testing.assert_array_equal(streaks(costs), [[1, 0], [2, 1], [0, 2], [1, 3]])


def test_costs_and_observations_are_those_of_the_wrapper():
    """On episodes of different lengths, against `emcc.StreakCost` around each environment; a second
    cost, another number of times the first, has a streak of its own."""

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
    """One more weight for each unit of their first layer; the policy has as many as without. Walk's
    steps cost 0 or 1, whatever is learned."""
    both = [trained(name, streak_weight=w) for w in (0.0, 3.0)]
    plain, of_streaks = (it.learner for it in both)
    assert of_streaks.nets.critic.sizes[0] == plain.nets.critic.sizes[0] + 1
    actors = [learner.state_dict()["actor"] for learner in (plain, of_streaks)]
    assert actors[0].shape == actors[1].shape
    assert (actors[0] != actors[1]).any()
    recorded = [it.recorder.take()["Walk-v0/0/costs/cost"] for it in both]
    assert {*np.concatenate(recorded)} == {0.0, 1.0}


@pytest.mark.parametrize("scale", [16.0, (16.0, 0.5)])
@pytest.mark.parametrize("name", FAMILIES)
def test_the_scale_is_that_of_observations(name, scale):
    """A scale in the networks is, bit for bit, one in the task: a power of two only moves the
    exponent."""
    inside = trained(name, input_scale=scale)
    outside = trained(name, parameters={"scale": scale})
    expected = outside.learner.state_dict()
    for key, value in inside.learner.state_dict().items():
        np.testing.assert_array_equal(value, expected[key], err_msg=key)
    if scale == 16.0:
        assert (trained(name).learner.state_dict()["actor"] != expected["actor"]).any()


def test_a_scale_for_each_number_needs_as_many(tmp_path):
    with pytest.raises(agents.UserError, match=r"input_scale .* 2, .*got \(1.0, 2.0, 3.0\)"):
        agents.train("cpo", "Walk-v0", seeds=[0], out=tmp_path, input_scale=[1.0, 2.0, 3.0])
    assert not list(tmp_path.iterdir())
