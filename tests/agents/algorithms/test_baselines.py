"""Objectives, penalties and steps of the algorithms by hand or by sampling."""

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
    """Return a policy with these means, one for each state, and σ = 1."""
    one = torch.ones(1, 1, 1)
    return Gaussian(torch.tensor(means).view(1, -1, 1), 0.0 * one, one)


def two_steps(reward, cost, **more):
    """Return a minibatch of two steps with equal weights."""
    nothing, half = torch.zeros(1, 2, 1), torch.full((1, 2), 0.5)
    gains = torch.tensor([reward]), torch.zeros(1, 2), torch.tensor([[cost]])
    return Minibatch(nothing, nothing, half, *gains, start=at(0.0, 0.0), **more)


def test_focops_surrogate_and_advantage():
    """Means 0.1 and 0.3 instead of 0 have the KL .005 and .045, of which the second exceeds
    δ = .02. With λ = 1.5 the surrogate is ½ (1.2·2/1.5 - .005) = .7975. With ν = 3 the advantages
    are 2 - 3·½ and 1 + 3·¼."""
    batch = two_steps([2.0, 3.0], [0.0, 0.0])
    config, ratio = focops.FOCOPSConfig(), torch.tensor([[1.2, 0.7]])
    value, outside = focops.surrogate(config, at(0.1, 0.3), ratio, batch)
    assert (value.item(), outside.item()) == pytest.approx((0.7975, 0.5))
    costs = torch.tensor([[[0.5, -0.25]]])
    found = focops.advantage(config, torch.tensor([[2.0, 1.0]]), costs, torch.tensor([[3.0]]))
    assert found.tolist() == [[0.5, 1.75]]


def test_cup_projection():
    """γ = .9 and λ = .5 give the factor (1 - .45)/.1 = 5.5; ν = 2. The steps' losses are
    .005 + 5.5·2·1.2·½ = 6.605 and .045 - 5.5·2·.7 = -7.655, with mean -.525."""
    batch = two_steps([0.0, 0.0], [0.5, -1.0], multipliers=torch.tensor([[2.0]]))
    config = cup.CUPConfig(discount=0.9, gae_lambda=0.5)
    value, _ = cup.projection(config, at(0.1, 0.3), torch.tensor([[1.2, 0.7]]), batch)
    assert value.item() == pytest.approx(0.525, abs=1e-5)


@pytest.mark.parametrize(("excess", "penalty"), [(3.0, 0.8), (-6.0, 0.0)])
def test_p3o_surrogate(excess, penalty):
    """ρ = 1.5 and ½, ε = .2. Reward: min(1.5, 1.2) and min(-.5, -.8) have the mean .2. Cost:
    max(1.5, 1.2) and max(-.5, -.8) have the mean ½. With γ = .9 the penalties are ½ + .1·3 = .8,
    and 0 since ½ - .1·6 < 0; their factor is κ = 20."""
    batch = two_steps([1.0, -1.0], [1.0, -1.0], excess=torch.tensor([[excess]]))
    config, ratio = p3o.P3OConfig(discount=0.9), torch.tensor([[1.5, 0.5]])
    value, outside = p3o.surrogate(config, at(0.0, 0.0), ratio, batch)
    assert (value.item(), outside.item()) == pytest.approx((0.2 - 20 * penalty, 1.0), abs=1e-5)


def test_multipliers_of_this_epochs_cost():
    """IPO: 1 / (20·(25 - J)), at most 1. CRPO reduces the cost above 25.5. C-TRPO recovers from a
    cost of 25 until it is below 20. FOCOPS: ν = .01 (J - 25), clipped to [0, 2]."""
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
    """Return a problem with H = 2 I and δ = 0.01, whose trust region is a disc of radius 0.1."""
    gradient, b = torch.tensor([gradient]), torch.tensor([b])
    what = (gradient, lambda: b, torch.tensor([excess]), lambda v: 2 * v, lambda v: v / 2, 0.01)
    return Problem(*what, torch.tensor([[multiplier]]))


@pytest.mark.parametrize("projection", ["kl", "l2"])
def test_pcpo_step(projection):
    """The reward's step is (0.1, 0). With b = (3, 4) and c = .2 it lies (.3 + .2)/5 = .1 beyond the
    plane. Both norms project it along b/5 = (.6, .8), since H is a multiple of the identity."""
    config = pcpo.PCPOConfig(projection=projection)
    step = pcpo.step(config, problem([1.0, 0.0], [3.0, 4.0], 0.2))
    assert step.displacement[0].tolist() == pytest.approx([0.1 - 0.06, -0.08], abs=1e-6)
    step = pcpo.step(config, problem([1.0, 0.0], [3.0, 4.0], -0.4))  # within the plane
    assert step.displacement[0].tolist() == pytest.approx([0.1, 0.0], abs=1e-6)


def test_rcpo_takes_its_whole_step_without_a_line_search():
    step = rcpo.step(rcpo.RCPOConfig(), problem([1.0, 0.0], [3.0, 4.0], 9.0))
    assert step.displacement[0].tolist() == pytest.approx([0.1, 0.0], abs=1e-6)
    assert step.divergence(torch.tensor([5.0]), torch.tensor([7.0])).item() <= 0.01
    assert not step.must_improve
    assert step.cost_bound == math.inf


def test_c_trpo_step():
    """With Δ = 5 left to the limit and β = 1, H + b bᵀ/Δ for b = (3, 4) is the matrix
    M = [[3.8, 2.4], [2.4, 5.2]], and M⁻¹g = (5.2, -2.4)/14 for g = (1, 0). ½ xᵀMx = .01 gives
    x = (.0861892, -.0397796). The divergence of a cost growth of 2.5 is 2.5 + 2.5 log ½ = .7671320;
    at the limit and beyond it is infinite."""
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


def test_cal_risk_multiplier_and_loss():
    """1, 2, 3, 4 have the mean 2.5 and the deviation 1.2909944, with k = ½ a risk of 3.1454972.
    With λ = ½, c = 10 and d = 5 the augmented multipliers are ½ - 10·.02 = .3, 0 and 1.5. Critics
    of 1 and 2 with targets ½ + .9·3 = 3.2 and ½ + .9·4 = 4.1 have the loss ½ (2.2² + 2.1²)."""
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
    """Return WCSAC's two cost critics' outputs [1, 2, B] for a mean and a variance [B] each."""
    raw = torch.tensor([variance]).double().expm1().log().float()  # the inverse of softplus
    return torch.stack((torch.tensor([mean]), raw), dim=1)


@pytest.mark.parametrize("level", [0.1, 0.5, 0.9, 1.0])
def test_risk_is_the_mean_of_the_worst_share_of_a_gaussian(level):
    samples = np.sort(np.random.default_rng(0).normal(2.0, 1.5, 2_000_000))
    worst = samples[int((1 - level) * len(samples)) :].mean()
    config = WCSACConfig(risk_level=level)
    risk = RULE.risk(config, outputs([2.0], [1.5**2]))
    assert risk.item() == pytest.approx(worst, abs=0.005)


def test_wcsacs_targets_by_hand():
    """γ = 0.9, c = 1, Q_c = 2, Q_c' = 3, V_c' = 0.5: the mean's target is 1 + 0.9·3 = 3.7, the
    variance's 1 - 4 + 2·0.9·1·3 + 0.81·0.5 + 0.81·9 = 10.095.

    In a terminal step with Q_c = 0.5 they are 1 and 1 - 0.25 = 0.75."""
    following = outputs([3.0, 3.0], [0.5, 0.5])
    discount = torch.tensor([[0.9, 0.0]])
    mean, variance = targets(discount, torch.tensor([[2.0, 0.5]]), following, torch.ones(1, 2))
    assert mean[0].tolist() == pytest.approx([3.7, 1.0])
    assert variance[0].tolist() == pytest.approx([10.095, 0.75], rel=1e-6)


@pytest.mark.parametrize(
    ("variance_target", "terminal", "by_hand"),
    [("squared", 0, 2.1379740), ("unsquared", 0, 1.4864755), ("unsquared", 1, 0.5414755)],
)
def test_wcsacs_critic_loss_by_hand(variance_target, terminal, by_hand):
    """Q_c = 2, V = 4; targets 3.7 and 10.095 (above).

    ½ (2 - 3.7)² + ½ (4 + 10.095 - 2 √40.38) = 1.445 + ½ (14.095 - 12.7090519) = 2.1379740

    The later library's variance target is 5.235 (below): 1.445 + ½ (9.235 - 2 √20.94) = 1.4864755.
    It is the same at an episode's end, where the mean's target is 1: ½ (2 - 1)² + .0414755.
    """
    config = replace(CONFIG, variance_target=variance_target)
    ones, ends, unused = torch.ones(1, 1), torch.full((1, 1), float(terminal)), torch.zeros(1, 1)
    batch = Batch(unused, unused, unused, ones, unused, unused, ends)
    loss = RULE.critic_loss(config, outputs([2.0], [4.0]), outputs([3.0], [0.5]), batch)
    assert loss.item() == pytest.approx(by_hand, rel=1e-5)


def test_variance_target_of_the_later_library_by_hand():
    """The target without the square on the last term: 1 - 4 + 5.4 + 0.405 + 0.81·3 = 5.235. With
    Q_c = 0.5 it is 1 - 0.25 + 5.4 + 0.405 + 2.43 = 8.985; ends of episodes are not masked."""
    following = outputs([3.0, 3.0], [0.5, 0.5])
    means, cost = torch.tensor([[2.0, 0.5]]), torch.ones(1, 2)
    found = unsquared_variance_target(0.9, means, following, cost)
    assert found[0].tolist() == pytest.approx([5.235, 8.985], rel=1e-6)
    cheap = unsquared_variance_target(0.9, means + 3, following, cost)
    assert cheap[0].tolist() == pytest.approx([1e-8] * 2)  # below 0: clamped


@pytest.mark.parametrize(("gradient", "by_hand"), [("stopped", 11.0), ("through", 71.0)])
def test_wcsacs_penalty_is_damped(gradient, by_hand):
    """d = 5, Γ = 4 and 8: the damping is 10 (5 - 6) = -10, the penalty (κ - κ_d) Γ = (1 + 10) Γ.
    Its slope is 11; a gradient through the damping, 10 (5 - mean Γ), adds 10/2 · Σ Γ = 60."""
    risk = torch.tensor([[[4.0, 8.0]]], requires_grad=True)
    penalty = RULE.penalty(replace(CONFIG, damping_gradient=gradient), risk, torch.ones(1, 1))
    assert penalty[0, 0].tolist() == pytest.approx([44.0, 88.0])
    (slope,) = torch.autograd.grad(penalty.sum(), risk)
    assert slope[0, 0].tolist() == pytest.approx([by_hand, by_hand])


@pytest.mark.parametrize("t", [0.5, 1.0, 3.0, 20.0])
def test_the_barriers_value_and_slope_are_continuous_at_the_switch(t):
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
    # The barrier at z = -1 and 2: see above. There is no multiplier.
    penalty = sac_lb.RULE.penalty(config, risk, torch.zeros(1, 0))
    assert penalty[0, 0].tolist() == pytest.approx([0.0, 7.0657415], abs=1e-6)
    assert sac_lb.RULE.multipliers == ()


def test_the_barrier_of_ipo_follows_the_discounted_cost():
    """1 / (20 · (25 - 20)); the undiscounted cost is above the limit."""
    config, rule = ipo.IPOConfig(), ipo.RULE.multipliers
    states = lagrange.initial(rule, config, 1)
    states = lagrange.follow(rule, config, states, np.array([[30.0]]), np.array([[20.0]]))
    assert lagrange.values(rule, states, 1).item() == pytest.approx(0.01)


# From Zhang et al., Yang et al. and OmniSafe, as the fields' docstrings say.
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
def test_defaults_are_the_published_ones(name):
    config = ALGORITHMS[name].config()
    assert {k: getattr(config, k) for k in DEFAULTS[name]} == DEFAULTS[name]
