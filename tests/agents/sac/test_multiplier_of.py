"""The costs that multipliers of the SAC family follow, recomputed from the run's rollouts."""

import numpy as np
import pytest
import torch
from small_trainings import small, trainer
from toys import register

from agents.algorithms import wcsac
from agents.sac import update as sac
from agents.sac.replay import EPISODES, STARTS
from agents.training.config import TrainConfig

register()
RATE = 0.001


def training(name, multiplier_of, **changes):
    own = {"multiplier_of": multiplier_of, "multiplier_lr": RATE, "multiplier_optimizer": "sgd"}
    own = small(name, **own, random_steps=40, **changes)
    return trainer(TrainConfig(name, ("Walk-v0",), (0, 1), 100_000, own))


def epochs(it, count):
    """Yield each epoch's rollout, the state before it, and its metrics by name."""
    learn = it.learner.learn
    for _ in range(count):
        seen = {}

        def noted(rollout, epoch, active, seen=seen):
            seen["rollout"], seen["before"] = rollout, it.learner._state
            seen["metrics"] = learn(rollout, epoch, active)
            return seen["metrics"]

        it.learner.learn = noted
        it.run_epoch()
        metrics = dict(zip(it.learner.metrics, seen["metrics"].T, strict=True))
        yield seen["rollout"], seen["before"], metrics


@pytest.mark.parametrize("name", ["sac-lag", "wcsac"])
def test_a_multiplier_of_episodes_follows_the_cost_of_the_last_ten(name):
    """For WCSAC the mean of their worst half; of an odd number the middle one counts half.

    The multiplier's parameter rises by its slope times the excess.
    """
    it, costs, compared = training(name, "episode", cost_limit=3.0), [[], []], 0
    assert it.config.learned.cost_limit == 3.0
    for rollout, before, metrics in epochs(it, 30):
        for run in range(2):
            own = np.sum(rollout.cost[: rollout.length[run], run, 0])
            costs[run] = [*costs[run], own][-EPISODES:]
            if np.isnan(metrics["risk"][run]):
                continue
            expected = np.mean(costs[run])
            if name == "wcsac":
                worst, half = sorted(costs[run], reverse=True), len(costs[run]) / 2
                whole = int(half)
                rest = (half - whole) * worst[whole] if half > whole else 0.0
                expected = (sum(worst[:whole]) + rest) / half
            assert metrics["risk"][run] == pytest.approx(expected, rel=1e-6)
            parameter = before.multipliers[0].parameter[run, 0].item()
            for _ in range(it.learner.config.gradient_steps):
                slope = np.exp(parameter) if name == "wcsac" else 1 / (1 + np.exp(-parameter))
                parameter += RATE * slope * (expected - 3.0)
            after = it.learner._state.multipliers[0].parameter[run, 0].item()
            assert after == pytest.approx(parameter, rel=1e-4, abs=1e-5)
            compared += 1
    assert compared > 30


@pytest.mark.parametrize("normalize", [False, True])
@pytest.mark.parametrize("name", ["sac-lag", "cal", "wcsac"])
def test_a_multiplier_of_start_follows_the_risk_at_start_states(name, normalize):
    """The risk is that of the networks before the gradient step, at start states alone."""
    it = training(name, "start", gradient_steps=1, normalize_observations=normalize)
    starts, compared, moments = [[], []], 0, None
    for rollout, before, metrics in epochs(it, 12):
        moments, before_it = it.learner.state_dict().get("actor.observations"), moments
        for run in range(2):
            starts[run].append(rollout.observation[0, run])
        moments = None if moments is None else moments.copy()
        if np.isnan(metrics["risk"]).any():
            continue
        [(_, noise)] = it.learner._draws(int(it.epochs.max()) - 1)
        for run in range(2):
            own = np.stack(starts[run])
            if normalize:  # by the moments after the epoch before
                count, mean, squares = before_it[run]
                own = (own - mean) / np.sqrt(squares / count + 1e-8)
                own = own.clip(-10, 10).astype(np.float32)
            nets, observation = it.learner.nets, torch.from_numpy(own)[None]
            actor, critics = (torch.from_numpy(x[[run]]) for x in (before.actor, before.critics))
            outputs = nets.actor.forward(actor, observation).numpy()
            action = sac.act(outputs, noise.start_action[[run], : len(own)])
            seen = torch.cat([observation, torch.from_numpy(action)], dim=-1)
            q = nets.critic.forward_each(critics, seen)
            risk = it.learner.rule.risk(it.learner.config, q[:, 2:]).mean().item()
            assert metrics["risk"][run] == pytest.approx(risk, rel=1e-4)
            compared += 1
    assert compared >= 10


def test_the_last_starts_are_kept():
    it = training("sac-lag", "start")
    starts = [rollout.observation[0, 1] for rollout, *_ in epochs(it, STARTS + 9)]
    kept, weight = it.learner._recent.starts
    assert {row.tobytes() for row in kept[1]} == {row.tobytes() for row in starts[-STARTS:]}
    np.testing.assert_allclose(weight, 1 / STARTS)


def test_wcsacs_damping_is_of_what_the_multiplier_follows():
    """κ = 2, d = 5, damping 10: 2 - 10 (5 - 5.5) = 7, whatever the batch's risk."""
    config = wcsac.WCSACConfig(cost_limit=5.0, multiplier_of="start")
    seen = wcsac.RULE.augmented(config, torch.tensor([[2.0]]), torch.tensor([[5.5]]))
    risk = torch.tensor([[[1.0, 3.0]]])
    assert wcsac.RULE.penalty(config, risk, seen)[0, 0].tolist() == [7.0, 21.0]
