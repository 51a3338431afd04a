"""FOCOPS and CUP: multiplier, advantages and early stopping as in their authors' code."""

import numpy as np
import pytest
import torch
from small_trainings import small, trainer
from torch.distributions import Normal, kl_divergence
from toys import register

from agents import first_order
from agents.on_policy.epoch import divergence
from agents.training.config import TrainConfig

register()
BOTH = ("focops", "cup")


def training(name, task="Circle2D-1-v0", **changes):
    own = small(name, **changes)
    return trainer(TrainConfig(name, (task,), (0, 1), 100_000, own))


@pytest.mark.parametrize("name", BOTH)
@pytest.mark.parametrize("limit_of", ["discounted", "episode"])
def test_the_multiplier_follows_the_discounted_cost(name, limit_of):
    """ν ← min(max(ν + η (J - d'), 0), ν_max), from the costs of each epoch, with d' = d, or for a
    limit of the episode's cost d times the mean of γ^t over the task's 50 steps."""
    changes = {"cost_limit": 4.0, "limit_of": limit_of, "discount": 0.9, "multiplier_lr": 0.3}
    it, nu, learn = training(name, **changes), np.zeros(2), None
    limit = 4.0 * (1.0 if limit_of == "discounted" else np.mean(0.9 ** np.arange(50)))
    used, learn = [], it.learner.learn

    def noted(rollout, *others):
        nonlocal nu
        discounts = 0.9 ** np.arange(len(rollout.cost))
        costs = (rollout.cost[..., 0] * discounts[:, None]).sum(axis=0).reshape(2, -1).mean(axis=1)
        nu = np.clip(nu + 0.3 * (costs - limit), 0.0, 2.0)
        metrics = learn(rollout, *others)
        used.append(metrics[:, it.learner.metrics.index("multiplier")])
        np.testing.assert_allclose(used[-1], nu, rtol=1e-5, atol=1e-6)
        return metrics

    it.learner.learn = noted
    for _ in range(12):
        it.run_epoch()
    assert np.ptp(np.stack(used)) > 0.2


@pytest.mark.parametrize("name", BOTH)
def test_both_advantages_are_standardised(name, monkeypatch):
    it, epochs = training(name), []
    improve = it.learner.improve
    monkeypatch.setattr(
        it.learner, "improve", lambda epoch, *o: epochs.append(epoch) or improve(epoch, *o)
    )
    for _ in range(3):
        it.run_epoch()
    for epoch in epochs:
        held = epoch.weight > 0
        for run in range(2):
            for gains in (epoch.reward_advantage[run], epoch.cost_advantage[run, 0]):
                own = gains[held[run]]
                assert own.mean().item() == pytest.approx(0.0, abs=1e-5)
                assert own.std(correction=0).item() == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize("name", BOTH)
def test_passes_end_by_the_divergence_from_the_new_policy_to_the_old(name, monkeypatch):
    """Against torch.distributions, at every check of an epoch. Both steps of CUP measure from the
    policy before the first."""
    it, checked = training(name, kl_stop=1e9, actor_iterations=3), []
    start = it.learner._state.actor.clone()

    def noted(nets, actor, steps, reverse):
        found = divergence(nets, actor, steps, reverse)
        for run in range(2):
            new, old = (
                nets.actor.distribution(params, steps.observation) for params in (actor, start)
            )
            pair = [Normal(of.mean[run], of.std[run].expand_as(of.mean[run])) for of in (new, old)]
            mean = (steps.weight[run] * kl_divergence(*pair).sum(dim=-1)).sum()
            assert found[run].item() == pytest.approx(mean.item(), rel=1e-3, abs=1e-7)
        checked.append(found)
        return found

    monkeypatch.setattr(first_order, "divergence", noted)
    it.run_epoch()
    assert len(checked) == 3 * len(it.learner.rule.surrogates)
    assert torch.stack(checked)[-1].min() > 1e-6
