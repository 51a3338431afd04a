"""Inputs of an epoch's updates: replay, noise and policy; runs that learn or wait."""

from dataclasses import replace

import numpy as np

from agents.paper.presets import preset
from agents.training.config import TrainConfig
from agents.training.loop import Training


def training(**changes):
    hyperparameters = replace(preset("sac-lag", "Circle2D-1-v0"), **changes)
    return Training(TrainConfig("sac-lag", "Circle2D-1-v0", (0, 1), 10_000, hyperparameters))


def test_every_slot_is_drawn_and_noise_is_fresh():
    it = training(batch_size=64)
    for _ in range(40):
        it.run_epoch()
    draws = [draw for epoch in range(40) for draw in it.learner._draws(epoch)]
    slots = np.concatenate([index.ravel() for index, _ in draws])
    assert slots.min() == 0
    assert slots.max() == 1999
    counts = np.bincount(slots, minlength=2000)
    assert counts.max() < 45  # of 12.8 on average
    noises = [n.numpy() for _, noise in draws[:6] for n in noise]
    for i, a in enumerate(noises):
        assert not any(np.array_equal(a, b) for b in noises[:i])
    assert not np.array_equal(noises[0][0], noises[0][1])


def test_episodes_start_elsewhere_and_the_policy_explores():
    it = training(random_steps=0)
    starts, spread = [], []
    for _ in range(3):
        it.run_epoch()
        rows = it.learner._replay._rows[0]
        starts.append(rows[it.steps[0] - 50, :2].copy())
        observation = rows[it.steps[0] - 50 : it.steps[0], :2]
        deterministic = it.learner.policy()(np.stack([observation] * 2), None)[0]
        spread.append(np.abs(rows[it.steps[0] - 50 : it.steps[0], 2:4] - deterministic).mean())
    assert len({tuple(s) for s in starts}) == 3
    assert min(spread) > 0.1  # the untrained policy's deviation is about 1


def test_metrics_are_means_over_gradient_steps():
    """The temperature moves by its learning rate at most, so its mean stays near 1."""
    it = training(gradient_steps=20)
    for _ in range(6):
        it.run_epoch()
    temperature = it.log.updates[:, :, it.learner.metrics.index("temperature")]
    assert np.isnan(temperature[4]).all()
    np.testing.assert_allclose(temperature[5], 1.0, atol=20 * 3e-4 + 1e-6)


def test_initial_multiplier():
    it = training(initial_multiplier=3.0)
    for _ in range(6):
        it.run_epoch()
    multiplier = it.log.updates[5, :, it.learner.metrics.index("multiplier")]
    np.testing.assert_allclose(multiplier, np.log1p(np.exp(3.0)), rtol=1e-3)
