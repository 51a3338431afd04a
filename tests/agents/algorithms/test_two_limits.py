"""User-defined algorithms with two costs, limits and multipliers."""

from dataclasses import dataclass, replace
from typing import Annotated

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.envs.registration import EnvSpec
from small_trainings import finished, of_run, small, trainer
from toys import register as register_toys

import agents
from agents import algorithms
from agents.algorithms import algorithm
from agents.checks import In
from agents.errors import UserError
from agents.first_order import Objective, clipped
from agents.lockstep import lagrange
from agents.training.config import TrainConfig

register_toys()
TWO = {"sac-two": "sac-lag", "trpo-two": "trpo-lag", "ppo-two": "ppo-lag"}
"""Algorithms with a second multiplier, of a second cost, and what each is derived from."""
COSTS = ("cost", "cost_2")


def with_second(base):
    @dataclass(frozen=True)
    class Config(base):
        cost_limit_2: Annotated[float, In(0, 1e9)] = 1.0

    return Config


@pytest.fixture(autouse=True)
def two_limits(monkeypatch):
    monkeypatch.setattr(algorithms._algorithms, "registered", {})
    for name, of_one in TWO.items():
        own = algorithm(of_one)
        (first,) = own.rule.multipliers
        both = (first, first._replace(signal=1, limit="cost_limit_2"))
        rule = own.rule._replace(multipliers=both, costs=2)
        agents.register(name, own._replace(config=with_second(own.config), rule=rule))


def config(name, seeds=(0, 1), **changes):
    own = small(name, multiplier_optimizer="sgd", multiplier_lr=0.1, **changes)
    return TrainConfig(name, ("TwoCosts-v0",), seeds, 300, own, costs=COSTS)


def multiplier_values(it):
    states = it.learner._state.multipliers
    return lagrange.values(it.learner.rule.multipliers, states, len(it.config.seeds))


def test_penalties_by_hand():
    """Off-policy each risk is multiplied by its multiplier: 2·(1, 3) and 5·(4, 0).

    On-policy the advantage is (A_r - Σ λ_k A_k) / (1 + Σ λ_k): (7 - 2·1 - 5·4) / 8 = -15/8 and
    (2 - 2·3 - 0) / 8 = -1/2; with one multiplier (7 - 2) / 3 and (2 - 6) / 3; with none A_r.
    """
    both, multipliers = torch.tensor([[[1.0, 3.0], [4.0, 0.0]]]), torch.tensor([[2.0, 5.0]])
    penalty = algorithm("sac-two").rule.penalty(None, both, multipliers)
    assert penalty.tolist() == [[[2.0, 6.0], [20.0, 0.0]]]
    reward = torch.tensor([[7.0, 2.0]])
    for name in ("trpo-two", "ppo-two"):
        advantage = algorithm(name).rule.advantage
        assert advantage(None, reward, both, multipliers).tolist() == [[-15 / 8, -1 / 2]]
        one = advantage(None, reward, both[:, :1], multipliers[:, :1])
        torch.testing.assert_close(one, torch.tensor([[5 / 3, -4 / 3]]))
    for name in ("ppo", "cpo"):
        assert algorithm(name).rule.advantage(None, reward, both, torch.zeros(1, 0)) is reward


def test_training_on_fewer_costs_than_limits_is_refused(tmp_path):
    with pytest.raises(UserError, match="limits 2 costs"):
        agents.train("trpo-two", "TwoCosts-v0", costs=("cost",), out=tmp_path / "x")


def test_off_policy_each_follows_the_risk_of_its_cost():
    """With SGD through softplus a parameter rises by 0.1·σ(5)·(risk - d) for the recorded risk;
    σ(5) = 0.9933071."""
    changes = {"gradient_steps": 1, "initial_multiplier": 5.0}
    it = trainer(config("sac-two", cost_limit=0.5, cost_limit_2=7.0, **changes))
    it.run_epoch()
    while "risk" not in it.recorder.latest[it.config.runs[0]]:
        assert all((s.parameter[0] == 5.0).all() for s in it.learner._state.multipliers)
        it.run_epoch()
    it.recorder.latest = {run: it.recorder.latest[run] for run in it.config.runs[:1]}
    for run, numbers in enumerate(it.recorder.latest.values()):
        for k, (risk, limit) in enumerate((("risk", 0.5), ("risk_2", 7.0))):
            moved = it.learner._state.multipliers[k].parameter[run, 0].item() - 5.0
            assert moved == pytest.approx(0.09933071 * (numbers[risk] - limit), rel=1e-4)
    assert numbers["risk"] != numbers["risk_2"]


@pytest.mark.parametrize("name", ["trpo-two", "ppo-two"])
def test_on_policy_each_follows_the_mean_cost_of_its_episodes(name):
    """With SGD λ rises by 0.1 (J_C - d), where J_C is computed here from the recorded costs."""
    it = trainer(config(name, initial_multiplier=5.0, cost_limit=3.0, cost_limit_2=7.0))
    it.run_epoch()
    for run in (0, 1):
        rows, count = of_run(it, run), it.learner.episodes
        for k, limit in enumerate((3.0, 7.0)):
            mean = rows[f"costs/{COSTS[k]}"].sum() / count
            expected = max(5.0 + 0.1 * (mean - limit), 0.0)
            assert multiplier_values(it)[run, k] == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("name", TWO)
def test_with_a_second_multiplier_of_0_it_is_the_algorithm_with_one(name):
    """The networks that both have start alike; on-policy the trained policy and the first
    multiplier agree as well. Off-policy the multiplier, a softplus, is never 0."""
    limits = {"cost_limit": 1.0, "initial_multiplier": 0.0}
    two = trainer(config(name, cost_limit_2=1e9, **limits))
    one = trainer(config(TWO[name], **limits))
    critics = one.learner._state.critics
    np.testing.assert_array_equal(two.learner._state.critics[:, : critics.shape[1]], critics)
    np.testing.assert_array_equal(two.learner._state.actor, one.learner._state.actor)
    if name != "sac-two":
        actors = [finished(it).learner.state_dict()["actor"] for it in (two, one)]
        np.testing.assert_allclose(*actors, rtol=0, atol=1e-5)
        values = [multiplier_values(it)[:, 0] for it in (two, one)]
        np.testing.assert_allclose(*values, rtol=1e-4)
        assert values[0].max() > 0


def test_limits_of_an_episode_are_those_of_a_cost_spread_evenly():
    """The limits of an episode of ten steps are 3 and 1. The training is the one whose limits of
    Q_c are these costs, spread evenly and discounted; results are compared with 3 and 1."""
    spread = {d: sum(d / 10 * 0.9**k for k in range(10)) for d in (3.0, 1.0)}
    limits = {"discount": 0.9, "initial_multiplier": 5.0}
    of_episode = config("sac-two", **limits, limit_of="episode", cost_limit=3.0, cost_limit_2=1.0)
    of_values = config("sac-two", **limits, cost_limit=spread[3.0], cost_limit_2=spread[1.0])
    assert spread[3.0] == pytest.approx(1.953965, rel=1e-6)
    assert of_episode.limits == {"cost": 3.0, "cost_2": 1.0}
    converted, given = (
        finished(trainer(replace(it, task_parameters={"max_episode_steps": 10})))
        for it in (of_episode, of_values)
    )
    assert converted.learner.config.cost_limit == pytest.approx(spread[3.0], rel=1e-12)
    for run in range(2):
        a, b = of_run(converted, run), of_run(given, run)
        assert a.keys() == b.keys()
        for name, value in a.items():
            np.testing.assert_allclose(value, b[name], rtol=1e-5, atol=1e-6, err_msg=name)


def test_limits_without_multipliers():
    """A surrogate sees by how much each cost exceeds its own limit, from the recorded costs; a cost
    without a limit has no excess. Off-policy both limits of an episode are converted."""
    seen, own = [], algorithm("ppo-two")

    def surrogate(config, policy, ratio, batch):
        seen.append(batch.excess)
        return clipped(config, policy, ratio, batch)

    limits = ("cost_limit", "cost_limit_2")
    rule = Objective(algorithm("ppo").rule.advantage, (), 2, limits, (surrogate,))
    agents.register("p3o-two", own._replace(rule=rule))
    it = trainer(config("p3o-two", cost_limit=3.0, cost_limit_2=7.0))
    assert it.config.limits == {"cost": 3.0, "cost_2": 7.0}
    it.run_epoch()
    for run in (0, 1):
        rows, count = of_run(it, run), it.learner.episodes
        means = [rows[f"costs/{name}"].sum() / count for name in COSTS]
        np.testing.assert_allclose(seen[0][run], np.array(means) - (3.0, 7.0), rtol=1e-5)
    without = rule._replace(limits=("cost_limit",))
    assert np.isnan(lagrange.limits(without, it.learner.config)).tolist() == [False, True]
    sac = algorithm("sac-two")
    agents.register("lb-two", sac._replace(rule=sac.rule._replace(multipliers=(), limits=limits)))
    tasks = {"task_parameters": {"max_episode_steps": 10}}
    changes = {"discount": 0.9, "limit_of": "episode", "cost_limit": 3.0, "cost_limit_2": 1.0}
    learned = replace(config("lb-two", **changes), **tasks).learned
    spread = sum(0.9**k for k in range(10)) / 10
    assert learned.cost_limit == pytest.approx(3.0 * spread)
    assert learned.cost_limit_2 == pytest.approx(spread)


def test_a_multiplier_of_what_is_not_there_is_refused():
    own = algorithm("ppo-two")
    first = own.rule.multipliers[0]
    for wrong, words in (
        (first._replace(signal=2), r"signal .* below costs=2, got 2"),
        (first._replace(limit="cost_limt"), "'cost_limt': did you mean 'cost_limit'"),
        (first._replace(highest="max_multiplier"), "highest .* hyper-parameter of Config"),
    ):
        with pytest.raises(ValueError, match=words):
            agents.register("wrong", own._replace(rule=own.rule._replace(multipliers=(wrong,))))
    # Otherwise a report would call a cost limited that is not learned.
    without = own.rule._replace(multipliers=())
    for changes, words in (
        ({"limits": ("cost_limit", "cost_limt_2")}, "'cost_limt_2': did you mean 'cost_limit_2'"),
        ({"limits": ("cost_limit", "cost_limit_2"), "costs": 1}, "at most costs=1, got"),
    ):
        with pytest.raises(ValueError, match=words):
            agents.register("wrong", own._replace(rule=without._replace(**changes)))


@pytest.mark.parametrize(("steps", "tasks"), [(80, ["Circle2D-1-v0"]), (None, [])])
def test_a_limit_of_an_episode_needs_one_time_limit(tmp_path, monkeypatch, steps, tasks):
    made = EnvSpec("Other-v0", lambda: gym.make("Circle2D-1-v0"), max_episode_steps=steps)
    monkeypatch.setitem(gym.registry, "Other-v0", made)
    own = small("sac-lag", limit_of="episode")
    with pytest.raises(UserError, match="limit_of episode needs tasks with one time limit"):
        TrainConfig("sac-lag", (*tasks, "Other-v0"), (0,), 100, own).write(tmp_path / "run")
    assert not (tmp_path / "run").exists()
