"""The log barrier against hand arithmetic, finite differences and its own two branches."""

import math

import pytest
import torch

from agents.algorithms.sac_lb import RULE, SACLBConfig, log_barrier


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


def test_by_hand():
    """t = 3: the switch is at -1/9.

    z = -1: -log(1)/3 = 0. z = -e: -1/3. z = 0: -log(1/9)/3 + 1/3 = (2.1972246 + 1)/3 = 1.0657415.
    z = 2: 6 + 1.0657415.
    """
    z = torch.tensor([-1.0, -math.e, 0.0, 2.0], dtype=torch.float64)
    expected = [0.0, -1 / 3, 1.0657415, 7.0657415]
    assert log_barrier(z, 3.0).tolist() == pytest.approx(expected, abs=1e-7)


@pytest.mark.parametrize("z", [-30.0, -2.0, -0.2, -0.1, 0.0, 0.3, 40.0])
@pytest.mark.parametrize("t", [1.0, 3.0])
def test_slope_against_finite_differences(z, t):
    h = 1e-6
    low, high = log_barrier(torch.tensor([z - h, z + h], dtype=torch.float64), t).tolist()
    at = torch.tensor(z, dtype=torch.float64, requires_grad=True)
    log_barrier(at, t).backward()
    assert at.grad.item() == pytest.approx((high - low) / (2 * h), rel=1e-5)
    assert at.grad.item() > 0  # more cost is never better


def test_penalty_is_of_the_cost_above_its_limit():
    config = SACLBConfig(cost_limit=5.0, log_barrier_factor=3.0)
    risk = torch.tensor([[[4.0, 7.0]]])
    # z = -1 and 2: see above; there is no multiplier
    penalty = RULE.penalty(config, risk, torch.zeros(1, 0))
    assert penalty[0, 0].tolist() == pytest.approx([0.0, 7.0657415], abs=1e-6)
    assert RULE.multipliers == ()
