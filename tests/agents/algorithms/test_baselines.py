"""Objectives, penalties and steps of the algorithms by hand, by sampling, by a known
distribution."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from agents.algorithms import (
    ALGORITHMS,
    c_trpo,
    cal,
    crpo,
    cup,
    focops,
    ipo,
    p3o,
    pcpo,
    rcpo,
    sac_lb,
)
from agents.algorithms.sac_lb import SACLBConfig, log_barrier
from agents.algorithms.wcsac import RULE, WCSACConfig, targets, unsquared_variance_target
from agents.first_order import Minibatch
from agents.lockstep import lagrange
from agents.on_policy.state import Gaussian
from agents.sac.replay import Batch
from agents.trust_region import Problem


def at(*means):
    """A policy of σ = 1 at some states."""
    one = torch.ones(1, 1, 1)
    return Gaussian(torch.tensor(means).view(1, -1, 1), 0.0 * one, one)


def two_steps(reward, cost, **more):
    """Two steps that count alike."""
    nothing, half = torch.zeros(1, 2, 1), torch.full((1, 2), 0.5)
    gains = torch.tensor([reward]), torch.zeros(1, 2), torch.tensor([[cost]])
    return Minibatch(nothing, nothing, half, *gains, start=at(0.0, 0.0), **more)


def test_focops():
    """Means 0.1 and 0.3 from 0: KL .005 and .045, the second is beyond δ = .02. With λ = 1.5:
    ½ (1.2·2/1.5 - .005) = .7975. Advantages 2 - 3·½ and 1 + 3·¼ for ν = 3."""
    batch = two_steps([2.0, 3.0], [0.0, 0.0])
    config, ratio = focops.FOCOPSConfig(), torch.tensor([[1.2, 0.7]])
    value, outside = focops.surrogate(config, at(0.1, 0.3), ratio, batch)
    assert (value.item(), outside.item()) == pytest.approx((0.7975, 0.5))
    costs = torch.tensor([[[0.5, -0.25]]])
    found = focops.advantage(config, torch.tensor([[2.0, 1.0]]), costs, torch.tensor([[3.0]]))
    assert found.tolist() == [[0.5, 1.75]]


def test_cup():
    """γ = .9, λ = .5: (1 - .45)/.1 = 5.5; ν = 2. .005 + 5.5·2·1.2·½ = 6.605 and
    .045 - 5.5·2·.7 = -7.655, of which the mean is -.525."""
    batch = two_steps([0.0, 0.0], [0.5, -1.0], multipliers=torch.tensor([[2.0]]))
    config = cup.CUPConfig(discount=0.9, gae_lambda=0.5)
    value, _ = cup.projection(config, at(0.1, 0.3), torch.tensor([[1.2, 0.7]]), batch)
    assert value.item() == pytest.approx(0.525, abs=1e-5)


@pytest.mark.parametrize(("excess", "penalty"), [(3.0, 0.8), (-6.0, 0.0)])
def test_p3o(excess, penalty):
    """ρ = 1.5 and ½, ε = .2. Reward: min(1.5, 1.2) and min(-.5, -.8): mean .2. Cost:
    max(1.5, 1.2) and max(-.5, -.8): mean ½. γ = .9: ½ + .1·3 = .8; ½ - .1·6 < 0; κ = 20."""
    batch = two_steps([1.0, -1.0], [1.0, -1.0], excess=torch.tensor([[excess]]))
    config, ratio = p3o.P3OConfig(discount=0.9), torch.tensor([[1.5, 0.5]])
    value, outside = p3o.surrogate(config, at(0.0, 0.0), ratio, batch)
    assert (value.item(), outside.item()) == pytest.approx((0.2 - 20 * penalty, 1.0), abs=1e-5)


def test_multipliers_of_this_epochs_cost():
    """IPO: 1 / (20·(25 - J)), at most 1. CRPO: against the cost above 25.5. C-TRPO: recovery from
    25 on, until below 20. FOCOPS: ν = .01 (J - 25), from 0, at most 2."""
    costs = torch.tensor([[20.0], [24.99], [25.0], [25.6], [26.0]])
    nothing = torch.zeros(5, 32)
    found = ipo.slope(ipo.IPOConfig(), nothing, costs)
    assert found[:, 0].tolist() == pytest.approx([0.01, 1, 1, 1, 1])
    assert crpo.rectifies(crpo.CRPOConfig(), nothing, costs)[:, 0].tolist() == [0, 0, 0, 1, 1]
    config = c_trpo.CTRPOConfig()
    assert c_trpo.recovers(config, nothing, costs)[:, 0].tolist() == [0, 0, 1, 1, 1]
    assert c_trpo.recovers(config, 1 + nothing, costs)[:, 0].tolist() == [1, 1, 1, 1, 1]
    assert c_trpo.recovers(config, 1 + nothing, costs - 0.1)[0, 0].item() == 0
    rule, config = focops.RULE, focops.FOCOPSConfig()
    states = lagrange.initial(rule.multipliers, config, 2)
    states = lagrange.follow(rule.multipliers, config, states, np.array([[75.0], [425.0]]))
    assert lagrange.values(rule.multipliers, states, 2)[:, 0].tolist() == pytest.approx([0.5, 2])


def problem(gradient, b, excess, multiplier=0.0):
    """H is 2, and δ = 0.01: the trust region is a disc of radius 0.1."""
    gradient, b = torch.tensor([gradient]), torch.tensor([b])
    what = (gradient, lambda: b, torch.tensor([excess]), lambda v: 2 * v, lambda v: v / 2, 0.01)
    return Problem(*what, torch.tensor([[multiplier]]))


@pytest.mark.parametrize("projection", ["kl", "l2"])
def test_pcpo(projection):
    """The reward's step is (0.1, 0). With b = (3, 4) and c = .2 it lies (.3 + .2)/5 = .1 beyond the
    plane, in either norm along b/5 = (.6, .8), since H is a multiple of the identity."""
    config = pcpo.PCPOConfig(projection=projection)
    step = pcpo.step(config, problem([1.0, 0.0], [3.0, 4.0], 0.2))
    assert step.displacement[0].tolist() == pytest.approx([0.1 - 0.06, -0.08], abs=1e-6)
    step = pcpo.step(config, problem([1.0, 0.0], [3.0, 4.0], -0.4))  # the step stays within
    assert step.displacement[0].tolist() == pytest.approx([0.1, 0.0], abs=1e-6)


def test_rcpo_searches_no_line():
    """The whole step, and any divergence will do."""
    step = rcpo.step(rcpo.RCPOConfig(), problem([1.0, 0.0], [3.0, 4.0], 9.0))
    assert step.displacement[0].tolist() == pytest.approx([0.1, 0.0], abs=1e-6)
    assert step.divergence(torch.tensor([5.0]), torch.tensor([7.0])).item() <= 0.01
    assert not step.must_improve
    assert step.cost_bound == math.inf


def test_c_trpo():
    """Room Δ = 5, β = 1. H + b bᵀ/Δ with b = (3, 4) is [[3.8, 2.4], [2.4, 5.2]] and g = (1, 0):
    its inverse takes g along (5.2, -2.4)/14; ½ xᵀ(..)x = .01 makes x = (.0861892, -.0397796).
    φ(2.5) = 2.5 + 2.5 log ½ = .7671320; at the limit and beyond it no step is near enough."""
    config = c_trpo.CTRPOConfig(cost_limit=25.0)
    step = c_trpo.step(config, problem([1.0, 0.0], [3.0, 4.0], -5.0))
    scale = math.sqrt(0.02 / (5.2 / 14)) / 14
    by_hand = [5.2 * scale, -2.4 * scale]
    assert by_hand == pytest.approx([0.0861892, -0.0397796], abs=1e-6)
    assert step.displacement[0].tolist() == pytest.approx(by_hand, abs=1e-6)
    kl = torch.tensor([0.001])
    found = [step.divergence(kl, torch.tensor([growth])).item() for growth in (2.5, 5.0, 6.0)]
    assert found == pytest.approx([0.768132, math.inf, math.inf])
    recovery = c_trpo.step(config, problem([1.0, 0.0], [3.0, 4.0], 9.0, multiplier=1.0))
    assert recovery.displacement[0].tolist() == pytest.approx([0.1, 0.0], abs=1e-6)
    assert recovery.divergence(kl, torch.tensor([7.0])).item() == pytest.approx(0.001)


def test_cal():
    """Of 1, 2, 3, 4 the mean is 2.5 and the deviation 1.2909944: with k = ½ a risk of 3.1454972.
    λ = ½, c = 10, d = 5: ½ - 10·.02 = .3, and 0 and 1.5. Critics 1 and 2 against ½ + .9·3 = 3.2 and
    ½ + .9·4 = 4.1: ½ (2.2² + 2.1²)."""
    config = cal.CALConfig(cost_limit=5.0, discount=0.9)
    values = torch.tensor([1.0, 2.0, 3.0, 4.0]).view(1, 4, 1)
    assert cal.risk(config, values).item() == pytest.approx(3.1454972)
    risks, half = torch.tensor([[4.98], [4.9], [5.1]]), torch.full((3, 1), 0.5)
    found = cal.augmented(config, half, risks)[:, 0].tolist()
    assert found == pytest.approx([0.3, 0, 1.5], abs=1e-5)
    unused, row = torch.zeros(1, 1), torch.zeros(1, 1, 1)
    batch = Batch(row, row, unused, unused + 0.5, row, unused, unused)
    loss = cal.critic_loss(config, values[:, :2], values[:, 2:], batch)
    assert loss.item() == pytest.approx(0.5 * (2.2**2 + 2.1**2))


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


@pytest.mark.parametrize(
    ("variance_target", "terminal", "by_hand"),
    [("squared", 0, 2.1379740), ("unsquared", 0, 1.4864755), ("unsquared", 1, 0.5414755)],
)
def test_critic_loss_by_hand(variance_target, terminal, by_hand):
    """Q_c = 2, V = 4; targets 3.7 and 10.095 (above).

    ½ (2 - 3.7)² + ½ (4 + 10.095 - 2 √40.38) = 1.445 + ½ (14.095 - 12.7090519) = 2.1379740

    Of the later library the variance's is 5.235 (below): 1.445 + ½ (9.235 - 2 √20.94) = 1.4864755.
    At an episode's end it is so too, where the mean's is 1: ½ (2 - 1)² + .0414755.
    """
    config = replace(CONFIG, variance_target=variance_target)
    ones, ends, unused = torch.ones(1, 1), torch.full((1, 1), float(terminal)), torch.zeros(1, 1)
    batch = Batch(unused, unused, unused, ones, unused, unused, ends)
    loss = RULE.critic_loss(config, outputs([2.0], [4.0]), outputs([3.0], [0.5]), batch)
    assert loss.item() == pytest.approx(by_hand, rel=1e-5)


def test_variance_target_of_the_later_library_by_hand():
    """That loss without the square on the last term: 1 - 4 + 5.4 + 0.405 + 0.81·3 = 5.235, and with
    Q_c = 0.5 1 - 0.25 + 5.4 + 0.405 + 2.43 = 8.985, at the end of an episode too: no mask."""
    following = outputs([3.0, 3.0], [0.5, 0.5])
    means, cost = torch.tensor([[2.0, 0.5]]), torch.ones(1, 2)
    found = unsquared_variance_target(0.9, means, following, cost)
    assert found[0].tolist() == pytest.approx([5.235, 8.985], rel=1e-6)
    cheap = unsquared_variance_target(0.9, means + 3, following, cost)
    assert cheap[0].tolist() == pytest.approx([1e-8] * 2)  # below 0: clamped


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


def test_the_barrier_of_ipo_follows_the_discounted_cost():
    """1 / (20 · (25 - 20)); the undiscounted cost is above the limit."""
    config, rule = ipo.IPOConfig(), ipo.RULE.multipliers
    states = lagrange.initial(rule, config, 1)
    states = lagrange.follow(rule, config, states, np.array([[30.0]]), np.array([[20.0]]))
    assert lagrange.values(rule, states, 1).item() == pytest.approx(0.01)


# Zhang et al., Yang et al., OmniSafe: see the fields' docstrings.
DEFAULTS = {
    "ipo": {"max_gradient_norm": 40.0, "kl_stop": 0.02, "log_barrier_factor": 20.0},
    "p3o": {"max_gradient_norm": 40.0, "kl_stop": 0.02, "penalty_factor": 20.0},
    "pcpo": {"line_search_steps": 200},
    "ppo": {"max_gradient_norm": 0.5, "kl_stop": 0.0, "actor_iterations": 10, "batch_size": 64},
    "ppo-lag": {"multiplier_lr": 0.035, "initial_multiplier": 0.001},
    "rcpo": {"multiplier_lr": 0.035},
    "focops": {"initial_log_std": -0.5, "kl_stop": 0.02, "max_multiplier": 2.0},
    "cup": {"initial_log_std": -0.5, "kl_stop": 0.02, "max_gradient_norm": 40.0},
}


@pytest.mark.parametrize("name", DEFAULTS)
def test_defaults_are_those_of_the_docstrings(name):
    config = ALGORITHMS[name].config()
    assert {k: getattr(config, k) for k in DEFAULTS[name]} == DEFAULTS[name]
