"""A limit of an episode's longest streak, as a second cost: its records, its critics and its
multiplier."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from gymnasium.spaces import Box
from small_trainings import of_run, small, trainer
from toys import Walk, register, registered

import agents
from agents.algorithms import algorithm
from agents.errors import UserError
from agents.lockstep import lagrange
from agents.lockstep.pulled import pulled
from agents.lockstep.rollout import Rollout, learned
from agents.lockstep.streaks import StreakTail
from agents.training.config import TrainConfig
from emcc import cvar, longest_streaks
from emcc.streaks import record

register()
NAMES = ("trpo-lag", "trpo-pid", "rcpo", "ppo-lag", "cppo-pid", "focops", "cup")
SGD = {"multiplier_optimizer": "sgd", "multiplier_lr": 0.1, "initial_multiplier": 0.5}


def config(name="ppo-lag", task="Walk-v0", costs=("cost",), **changes):
    own = small(name, **{"streak_limit": 1.0, "learning_rate": 0.01, **changes})
    return TrainConfig(name, (task,), (0, 1), 400, own, costs=costs)


def first_epoch(it):
    """Run an epoch and return its rollout as the task gave it."""
    seen, learn = [], it.learner.learn
    it.learner.learn = lambda rollout, *rest: learn(seen.append(rollout) or rollout, *rest)
    it.run_epoch()
    return seen[0]


def longest_of(rollout):
    """Return the longest streak of each episode, from its plain costs."""
    pairs = zip(rollout.cost[..., 0].T, rollout.length, strict=True)
    return np.array([longest_streaks(costs[:n], [n])[0] for costs, n in pairs])


@pytest.mark.parametrize("name", NAMES)
def test_each_multiplier_follows_its_cost(name):
    """With SGD λ ← (λ + η (J - d))₊, where J of the second multiplier is the mean longest streak.

    It is not discounted, not even in FOCOPS and CUP.
    """
    it = trainer(config(name, **SGD))
    rollout = first_epoch(it)
    longest = longest_of(rollout).reshape(2, -1).mean(axis=1)
    assert len(set(longest)) == 2
    states = it.learner._state.multipliers
    found = lagrange.values(it.learner.rule.multipliers, states, 2)
    np.testing.assert_allclose(found[:, 1], np.maximum(0.5 + 0.1 * (longest - 1), 0), rtol=1e-5)
    assert it.config.limits == {"cost": 1.0, "record_cost": 1.0}
    assert it.learner.metrics[-1] == "case" or it.learner.metrics[-1] == "multiplier_2"


def test_observations_have_the_streaks_and_records_their_growth():
    it = trainer(config())
    rollout = first_epoch(it)
    steps, episodes = rollout.reward.shape
    assert rollout.observation.shape == (steps, episodes, 4)
    for k, n in enumerate(rollout.length):
        plain, costs = rollout.cost[:n, k].T
        assert costs.tolist() == record(plain).tolist()
        streak, longest = rollout.next_observation[:n, k, 2:].T * 20
        np.testing.assert_allclose(longest, np.cumsum(costs), rtol=1e-6)
        last = np.flatnonzero(plain == 0)
        expected = [t - max(last[last <= t], default=-1) for t in range(n)]
        np.testing.assert_allclose(streak, expected, rtol=1e-6)
    own = of_run(it, 0)
    assert own["costs/record_cost"].sum() == longest_of(rollout)[:3].sum()


def test_a_cost_that_the_algorithm_does_not_limit_stands_last():
    it = config(task="TwoCosts-v0", costs=("cost", "cost_2"))
    assert it.costs == ("cost", "record_cost", "cost_2")
    assert it.task_costs == ("cost", "cost_2")
    assert replace(it, seeds=(3,)).costs == it.costs
    rollout = first_epoch(trainer(it))
    assert set(np.unique(rollout.cost[..., 2])) == {0.0, 0.25}


@pytest.mark.parametrize("alpha", [0.1, 0.5, 0.8])
def test_the_limited_cost_is_cvar_of_the_longest_streak(alpha):
    """In the first epoch, before which there are no episodes. An episode's learned cost is
    (L - η)₊ / α in sum, from the steps in which the streak is longer than η."""
    it = trainer(config(streak_alpha=alpha, episodes=8))
    epochs, make = [], it.learner._epoch
    it.learner._epoch = lambda rollout, packing: epochs.append(make(rollout, packing)) or epochs[-1]
    rollout = first_epoch(it)
    longest = longest_of(rollout).reshape(2, -1)
    expected = [cvar(own, alpha, ties="split") for own in longest]
    np.testing.assert_allclose(epochs[0].cost[:, 1], expected, rtol=1e-6)
    given = learned(rollout, it.learner.config, 2)
    costs, level = StreakTail(2, alpha).of(given)
    beyond = np.maximum(longest - level[:, None], 0).ravel() / alpha
    np.testing.assert_allclose(costs.cost_returns[:, 1], beyond)
    np.testing.assert_array_equal(costs.cost[..., 0], given.cost[..., 0])


def test_the_quantile_is_of_the_last_hundred_episodes():
    """L = 0, 1, ..., 129 in epochs of ten: a tenth of 30 to 129 is above 119."""
    tail = StreakTail(1, 0.1)
    for first in range(0, 130, 10):
        longest = np.arange(first, first + 10)
        cost = (np.arange(130)[:, None] < longest).astype(float)[..., None]
        numbers = np.zeros((130, 10, 1), np.float32)
        ends, lengths = np.zeros((130, 10), bool), np.full(10, 130)
        void = np.full(10, "", object)
        given = (numbers, numbers, cost[..., 0], cost, numbers, ends, ends, lengths, void)
        _, level = tail.of(Rollout._make(given))
    assert level.tolist() == [119]


@pytest.mark.parametrize(
    ("name", "own"),
    [("trpo-lag", {"episodes": 2, "streak_alpha": 0.5}), ("sac-lag", {"random_steps": 260})],
)
def test_reports_and_evaluations_show_both(tmp_path, name, own):
    options = {"steps": 300, "seeds": 0, "hidden": (8,), "streak_limit": 3.0, **own}
    runs = agents.train(name, "Circle2D-1-v0", out=tmp_path / "run", **options)
    assert [group.cost for group in runs.results] == ["cost", "record_cost"]
    plain, records = (runs.records_of(name) for name in ("cost", "record_cost"))
    (own,), (of_records,) = plain.values(), records.values()
    assert of_records.cost.tolist() == own.longest_streak.tolist()
    page = agents.report(runs, out=tmp_path / "page")
    assert "record_cost" in page
    alpha = options.get("streak_alpha", 1)
    assert (f"record_cost): its limit holds for CVaR_{alpha:g} of" in page) == (alpha < 1)
    found = agents.evaluate(runs.folder, episodes=3)
    assert found.longest_streaks.shape == (1, 3)
    kept = dict(np.load(runs.folder / "results.npz"))
    assert kept["Circle2D-1-v0/0/evaluation/deterministic/costs"].shape[1] == 2
    assert agents.resume(runs.folder, steps=400).config.costs == ("cost", "record_cost")


def test_settings_that_are_not_allowed(tmp_path):
    out = {"out": tmp_path / "x", "steps": 100}
    with pytest.raises(UserError, match=r"streak_alpha needs a streak_limit, got 0\.5 alone"):
        agents.train("ppo-lag", streak_alpha=0.5, **out)
    with pytest.raises(UserError, match="streak_weight must be 0 with a streak_limit"):
        agents.train("ppo-lag", streak_limit=3.0, streak_weight=0.5, **out)
    for name in ("cpo", "crpo", "ppo", "wcsac", "cal"):
        with pytest.raises(UserError, match=rf"{name} has no hyper-p.* it belongs to .*, sac-pid"):
            agents.train(name, streak_limit=3.0, **out)
    for name in ("sac-lb", "sac-lb-streak"):
        with pytest.raises(UserError, match=f"{name} has no hyper-parameter 'streak_alpha'"):
            agents.train(name, streak_limit=3.0, streak_alpha=0.5, **out)
    with pytest.raises(UserError, match=r"streak_weight must be 0 .*, got 0\.25"):
        agents.train("sac-lb-streak", streak_limit=3.0, **out)


class Counts(Walk):
    """A walk whose observations are whole numbers."""

    observation_space = Box(0, 9, (2,), np.int64)

    def observation(self):
        return np.zeros(2, np.int64)


@pytest.mark.parametrize("name", ["ppo-lag", "sac-lb", "ppo-saute"])
def test_nothing_can_be_added_to_observations_of_integers(tmp_path, name):
    limit = {"saute_discount": 1.0} if name == "ppo-saute" else {"streak_limit": 3.0}
    message = f"{name} on task 'Counts-v0': observe needs a flat Box of floats"
    with registered(Counts=Counts), pytest.raises(UserError, match=message):
        agents.train(name, "Counts-v0", steps=100, out=tmp_path / "x", **limit)
    assert not list(tmp_path.iterdir())


# Off-policy: one episode per epoch, a replay, and critics of the discounted record cost.

OFF_POLICY = {"random_steps": 40, "gradient_steps": 1, "replay_size": 400}


def epochs(it, count):
    """Yield each epoch's rollout as the task gave it, the state before, and which runs learned."""
    learn = it.learner.learn
    for _ in range(count):
        seen = []

        def noted(rollout, epoch, active, seen=seen):
            before = it.learner._state
            metrics = learn(rollout, epoch, active)
            seen += [rollout, before, np.isfinite(metrics).all(axis=1)]
            return metrics

        it.learner.learn = noted
        it.run_epoch()
        yield seen


def quantile(longest, alpha):
    """Return η of the last hundred episodes: at most the share α of them lies above it."""
    ordered = sorted(longest[-100:], reverse=True)
    return ordered[int(alpha * len(ordered))] if alpha < 1 else 0


@pytest.mark.parametrize("multiplier_of", ["replay", "start", "episode"])
@pytest.mark.parametrize(("name", "alpha"), [("sac-lag", 1.0), ("sac-lag", 0.5), ("sac-pid", 0.25)])
def test_off_policy_multipliers_follow_the_last_ten_episodes(name, alpha, multiplier_of):
    """They follow η + E[(L - η)₊] / α over these episodes, which is their mean for α = 1, whatever
    the first cost's multiplier follows.

    SAC-Lag's parameter rises by its slope, σ(parameter), times the excess; the PID controller adds
    its proportional gain times the excess to its initial value.
    """
    own = {"multiplier_of": multiplier_of, "streak_alpha": alpha, "streak_limit": 0.5}
    if name == "sac-lag":
        own |= {"multiplier_optimizer": "sgd", "multiplier_lr": 0.1}
    own |= {"pid_ki": 0.0, "pid_kd": 0.0}
    it = trainer(replace(config(name, **own, **OFF_POLICY), steps=10_000))
    longest, compared = [[], []], 0
    for rollout, before, learned_now in epochs(it, 30):
        for run, length in enumerate(longest_of(rollout)):
            longest[run].append(length)
            if not learned_now[run]:
                continue
            level, ten = quantile(longest[run], alpha), np.array(longest[run][-10:])
            excess = level + np.mean(np.maximum(ten - level, 0)) / alpha - 0.5
            after = it.learner._state.multipliers[1]
            if name == "sac-pid":
                start = np.log(2)  # softplus(0), which the integral keeps
                assert after.value[run, 0] == pytest.approx(max(start + 0.1 * excess, 0), rel=1e-5)
            else:
                start = before.multipliers[1].parameter[run, 0]
                rise = 0.1 / (1 + np.exp(-start)) * excess
                assert after.parameter[run, 0] == pytest.approx(start + rise, rel=1e-5, abs=1e-6)
            compared += 1
    assert compared > 20


@pytest.mark.parametrize("alpha", [1.0, 0.4])
def test_off_policy_critics_learn_the_record_cost_beyond_the_current_quantile(alpha):
    """The cost of every transition in the replay, old ones too, is 1/α where the longest streak
    grows beyond the current η."""
    it = trainer(replace(config("sac-lag", streak_alpha=alpha, **OFF_POLICY), seeds=(0,)))
    grown, longest = [], []
    for rollout, *_ in epochs(it, 12):
        plain, costs = rollout.cost[: rollout.length[0], 0].T
        assert costs.tolist() == record(plain).tolist()
        grown += (costs * np.cumsum(costs)).tolist()
        longest += longest_of(rollout).tolist()
    slots = np.arange(len(grown))[None]
    batch = it.learner._as_learned(it.learner._replay.gather(slots))
    expected = (np.array(grown) > quantile(longest, alpha)) / alpha
    assert 0 < expected.sum() < len(grown) / alpha
    np.testing.assert_allclose(batch.cost[0, 1], expected, rtol=1e-6)


def test_a_barrier_for_each_limit_by_hand():
    """t = 2, limits 5 and 3: z = -2 and 1 for the cost, -1 and 2 for the streak. Below z = -1/4 the
    barrier is -log(-z) / 2, above it the tangent 2 z + log(4)/2 + 1/2. Slopes against PyTorch."""
    rule = algorithm("sac-lb").rule
    it = small("sac-lb", cost_limit=5.0, streak_limit=3.0, log_barrier_factor=2.0)
    risk = np.array([[[3.0, 6.0], [2.0, 5.0]]])
    value, pull = pulled(rule.penalty, it, risk, np.zeros((1, 0)))
    tangent = np.log(4) / 2 + 0.5
    np.testing.assert_allclose(value, [[[-np.log(2) / 2, 2 + tangent], [0, 4 + tangent]]])
    leaf = torch.tensor(risk, requires_grad=True)
    rule.penalty(it, leaf, torch.zeros(1, 0)).sum().backward()
    np.testing.assert_allclose(pull(np.ones_like(risk)), leaf.grad)


def test_the_novelty_bonus_does_not_depend_on_streaks():
    learner = trainer(config("sac-lb-streak", streak_weight=0.0, **OFF_POLICY)).learner
    states = np.zeros((2, 3, 4), np.float32)
    states[..., 2:] = np.arange(3)[:, None]
    assert len(np.unique(learner._novelty.of(states)[0])) == 1
    assert learner.nets.actor.sizes[0] == 4 and learner.costs == 2
