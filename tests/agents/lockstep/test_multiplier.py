"""Multipliers of all three forms rise exactly when the cost is above its limit."""

from dataclasses import replace

import pytest
import torch

from agents.algorithms.trpo_lag import TRPOLagConfig
from agents.errors import UserError
from agents.lockstep import multiplier
from agents.lockstep.multiplier import EXP, PROJECTED, SOFTPLUS, MultiplierConfig
from agents.lockstep.nets import LANES

FORMS = {"softplus": SOFTPLUS, "exp": EXP, "projected": PROJECTED}
EXCESS = torch.tensor([[2.0], [-3.0], [0.0], [1e-3]])


@pytest.mark.parametrize("name", FORMS)
@pytest.mark.parametrize("optimizer", ["adam", "sgd"])
def test_rises_exactly_when_the_cost_is_above_the_limit(name, optimizer):
    config = MultiplierConfig(1.5, 1e-2, optimizer)
    form, before = FORMS[name], multiplier.initial(FORMS[name], config, 4)
    after = multiplier.ascend(form, config, before, EXCESS)
    change = multiplier.value(form, after, 4) - multiplier.value(form, before, 4)
    assert change.sign().flatten().tolist() == [1.0, -1.0, 0.0, 1.0]


@pytest.mark.parametrize("name", FORMS)
def test_slope_against_finite_differences(name):
    h, form = 1e-6, FORMS[name]
    at = torch.tensor([0.1, 0.7, 3.0], dtype=torch.float64)
    expected = (form.value(at + h) - form.value(at - h)) / (2 * h)
    torch.testing.assert_close(form.slope(at), expected, rtol=1e-6, atol=1e-8)


def test_steps_by_hand():
    """Plain gradient, λ = 0.5, lr 0.1: 0.5 + 0.1·2 = 0.7 and 0.5 - 0.1·3 = 0.2; lr 0.5 would give
    -1 there, which is projected to 0. Softplus: its slope at 0 is ½, so 0 + 0.1·½·2 = 0.1. Adam's
    first step is the step size."""
    config = MultiplierConfig(0.5, 0.1, "sgd")

    def step(form, config):
        state = multiplier.ascend(form, config, multiplier.initial(form, config, 4), EXCESS)
        assert (state.parameter == state.parameter[:, :1]).all()
        assert state.parameter.shape == (4, LANES)
        return state.parameter[:, 0].tolist()

    assert step(PROJECTED, config) == pytest.approx([0.7, 0.2, 0.5, 0.5001])
    assert step(PROJECTED, replace(config, multiplier_lr=0.5))[1] == 0.0
    assert step(SOFTPLUS, MultiplierConfig(0.0, 0.1, "sgd"))[0] == pytest.approx(0.1)
    by_adam = step(PROJECTED, replace(config, multiplier_optimizer="adam"))
    assert by_adam == pytest.approx([0.6, 0.4, 0.5, 0.6], abs=1e-5)


def test_an_algorithm_without_one():
    assert multiplier.initial(None, None, 3) is None
    assert multiplier.value(None, None, 3).tolist() == [[0.0]] * 3
    assert multiplier.ascend(None, None, None, EXCESS) is None


def test_what_is_not_allowed():
    with pytest.raises(UserError, match="multiplier_optimizer must be adam or sgd, got 'rms'"):
        TRPOLagConfig(multiplier_optimizer="rms")
    with pytest.raises(UserError, match="initial_multiplier must be at least 0, got -1"):
        TRPOLagConfig(initial_multiplier=-1)
