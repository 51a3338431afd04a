"""WCSAC's risk, targets and damping, and SAC-LB's barrier, against sampling and hand arithmetic."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from agents.algorithms import sac_lb
from agents.algorithms.sac_lb import SACLBConfig, log_barrier
from agents.algorithms.wcsac import RULE, WCSACConfig, targets, unsquared_variance_target
from agents.sac.replay import Batch

CONFIG = WCSACConfig(cost_limit=5.0, discount=0.9, damping=10.0)


def outputs(mean, variance):
    """The two cost critics' outputs [1, 2, B] that stand for these."""
    raw = torch.tensor([variance]).double().expm1().log().float()  # of softplus, turned round
    return torch.stack((torch.tensor([mean]), raw), dim=1)


@pytest.mark.parametrize("level", [0.1, 0.5, 0.9, 1.0])
def test_risk_is_the_mean_of_the_worst_share_of_a_gaussian(level):
    samples = np.sort(np.random.default_rng(0).normal(2.0, 1.5, 2_000_000))
    worst = samples[int((1 - level) * len(samples)) :].mean()
    config = WCSACConfig(risk_level=level)
    risk = RULE.risk(config, outputs([2.0], [1.5**2]))
    assert risk.item() == pytest.approx(worst, abs=0.005)


def test_targets_by_hand():
    """γ = 0.9, c = 1, Q_c = 2, Q_c' = 3, V_c' = 0.5: the mean's target is 1 + 0.9·3 = 3.7, the
    variance's 1 - 4 + 2·0.9·1·3 + 0.81·0.5 + 0.81·9 = 10.095.

    Terminal, with Q_c = 0.5: 1 and 1 - 0.25 = 0.75."""
    following = outputs([3.0, 3.0], [0.5, 0.5])
    discount = torch.tensor([[0.9, 0.0]])
    mean, variance = targets(discount, torch.tensor([[2.0, 0.5]]), following, torch.ones(1, 2))
    assert mean[0].tolist() == pytest.approx([3.7, 1.0])
    assert variance[0].tolist() == pytest.approx([10.095, 0.75], rel=1e-6)


def test_variance_target_is_the_variance_of_the_return():
    """A cost of 0 or 2 by a fair coin, then a future of mean 3 and variance 0.5.

    The return c + γ C' has mean 1 + γ 3 and variance 1 + γ² 0.5. Averaged over the coin, with
    Q_c = 1 + γ 3, the targets must say so."""
    gamma, cost = 0.9, torch.tensor([[0.0, 2.0]])
    following = outputs([3.0, 3.0], [0.5, 0.5])
    q = torch.full((1, 2), 1 + gamma * 3)
    mean, variance = targets(torch.full((1, 2), gamma), q, following, cost)
    assert mean.mean().item() == pytest.approx(1 + gamma * 3)
    # each half is clamped at 1e-8; this coin keeps one below: c = 0 gives -5.8, c = 2 gives 9.0
    raw = cost**2 - q**2 + 2 * gamma * cost * 3 + gamma**2 * (0.5 + 9)
    assert raw.mean().item() == pytest.approx(1 + gamma**2 * 0.5, rel=1e-6)
    assert variance[0, 1].item() == pytest.approx(raw[0, 1].item(), rel=1e-6)
    assert variance[0, 0].item() == pytest.approx(1e-8)


def batch_of(cost, cost_terminal):
    """Transitions of which a loss of costs sees these alone; [1, B]."""
    nothing = torch.zeros_like(cost)
    vector = nothing[..., None]
    return Batch(vector, vector, nothing, cost, vector, nothing, cost_terminal)


def test_critic_loss_by_hand():
    """Q_c = 2, V = 4; targets 3.7 and 10.095 (above).

    ½ (2 - 3.7)² + ½ (4 + 10.095 - 2 √40.38) = 1.445 + ½ (14.095 - 12.7090519) = 2.1379740
    """
    batch = batch_of(torch.ones(1, 1), torch.zeros(1, 1))
    loss = RULE.critic_loss(CONFIG, outputs([2.0], [4.0]), outputs([3.0], [0.5]), batch)
    assert loss.item() == pytest.approx(2.1379740, rel=1e-5)


def test_variance_target_of_the_later_library_by_hand():
    """As above, without the square on the last term: 1 - 4 + 5.4 + 0.405 + 0.81·3 = 5.235, and with
    Q_c = 0.5 1 - 0.25 + 5.4 + 0.405 + 2.43 = 8.985, at the end of an episode too: no mask."""
    following = outputs([3.0, 3.0], [0.5, 0.5])
    means, cost = torch.tensor([[2.0, 0.5]]), torch.ones(1, 2)
    found = unsquared_variance_target(0.9, means, following, cost)
    assert found[0].tolist() == pytest.approx([5.235, 8.985], rel=1e-6)
    cheap = unsquared_variance_target(0.9, means + 3, following, cost)
    assert cheap[0].tolist() == pytest.approx([1e-8] * 2)  # below 0: clamped


@pytest.mark.parametrize("terminal", [0.0, 1.0])
def test_critic_loss_of_the_later_library_by_hand(terminal):
    """Q_c = 2, V = 4; the mean's target 3.7, or 1 at an episode's end, where it keeps the mask; the
    variance's is 5.235 either way: ½ (2 - 3.7)² + ½ (4 + 5.235 - 2 √20.94), or ½ instead of the
    first term."""
    config = replace(CONFIG, variance_target="unsquared")
    batch = batch_of(torch.ones(1, 1), torch.full((1, 1), terminal))
    loss = RULE.critic_loss(config, outputs([2.0], [4.0]), outputs([3.0], [0.5]), batch)
    distance = 4 + 5.235 - 2 * np.sqrt(20.94)
    error = 0.5 * (2 - (1.0 if terminal else 3.7)) ** 2
    assert loss.item() == pytest.approx(error + 0.5 * distance, rel=1e-4)


@pytest.mark.parametrize(("gradient", "by_hand"), [("stopped", 11.0), ("through", 71.0)])
def test_penalty_is_damped(gradient, by_hand):
    """d = 5, Γ = 4 and 8: the damping is 10 (5 - 6) = -10; (κ - κ_d) Γ = (1 + 10) Γ. A gradient
    through the damping adds to the slope of (κ - 10 (5 - mean Γ)) Γ_i 10/2 · Σ Γ = 60 to the 11."""
    risk = torch.tensor([[[4.0, 8.0]]], requires_grad=True)
    penalty = RULE.penalty(replace(CONFIG, damping_gradient=gradient), risk, torch.ones(1, 1))
    assert penalty[0, 0].tolist() == pytest.approx([44.0, 88.0])
    (slope,) = torch.autograd.grad(penalty.sum(), risk)
    assert slope[0, 0].tolist() == pytest.approx([by_hand, by_hand])


@pytest.mark.parametrize("t", [0.5, 1.0, 3.0, 20.0])
def test_value_and_slope_are_continuous_at_the_switch(t):
    """At z = -1/t² the barrier is -log(1/t²)/t = 2 log(t)/t, its slope -1/(t z) = t."""
    switch = -1.0 / t**2
    z = torch.tensor([switch - 1e-9, switch, switch + 1e-9], dtype=torch.float64)
    z.requires_grad_()
    value = log_barrier(z, t)
    assert value.tolist() == pytest.approx([2 * math.log(t) / t] * 3, abs=1e-7)
    (slope,) = torch.autograd.grad(value.sum(), z)
    assert slope.tolist() == pytest.approx([t] * 3, rel=1e-6)


def test_the_barrier_by_hand():
    """t = 3: the switch is at -1/9.

    z = -1: -log(1)/3 = 0. z = -e: -1/3. z = 0: -log(1/9)/3 + 1/3 = (2.1972246 + 1)/3 = 1.0657415.
    z = 2: 6 + 1.0657415.
    """
    z = torch.tensor([-1.0, -math.e, 0.0, 2.0], dtype=torch.float64)
    expected = [0.0, -1 / 3, 1.0657415, 7.0657415]
    assert log_barrier(z, 3.0).tolist() == pytest.approx(expected, abs=1e-7)


def test_the_barriers_penalty_is_of_the_cost_above_its_limit():
    config = SACLBConfig(cost_limit=5.0, log_barrier_factor=3.0)
    risk = torch.tensor([[[4.0, 7.0]]])
    # z = -1 and 2: see above; there is no multiplier
    penalty = sac_lb.RULE.penalty(config, risk, torch.zeros(1, 0))
    assert penalty[0, 0].tolist() == pytest.approx([0.0, 7.0657415], abs=1e-6)
    assert sac_lb.RULE.multipliers == ()
