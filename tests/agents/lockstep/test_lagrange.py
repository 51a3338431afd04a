"""Multipliers of all three forms rise exactly when the cost is above its limit."""

from dataclasses import dataclass, replace

import pytest
import torch

from agents.algorithms.cpo import CPOConfig
from agents.algorithms.sac_lb import SACLBConfig
from agents.algorithms.trpo_lag import TRPOLagConfig
from agents.errors import UserError
from agents.lockstep import lagrange
from agents.lockstep.lagrange import EXP, PROJECTED, SOFTPLUS, MultiplierConfig
from agents.lockstep.nets import LANES

FORMS = {"softplus": SOFTPLUS, "exp": EXP, "projected": PROJECTED}


@dataclass(frozen=True)
class Config(MultiplierConfig):
    """As a family's config that has a limit."""

    cost_limit: float = 4.0


COST = 4.0 + torch.tensor([[2.0], [-3.0], [0.0], [1e-3]])


@pytest.mark.parametrize("name", FORMS)
@pytest.mark.parametrize("optimizer", ["adam", "sgd"])
def test_rises_exactly_when_the_cost_is_above_the_limit(name, optimizer):
    config = Config(initial_multiplier=1.5, multiplier_lr=1e-2, multiplier_optimizer=optimizer)
    form, before = FORMS[name], lagrange.initial(FORMS[name], config, 4)
    after = lagrange.follow(form, config, before, COST)
    change = lagrange.value(form, after, 4) - lagrange.value(form, before, 4)
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
    config = Config(initial_multiplier=0.5, multiplier_lr=0.1, multiplier_optimizer="sgd")

    def step(form, config):
        state = lagrange.follow(form, config, lagrange.initial(form, config, 4), COST)
        assert (state.parameter == state.parameter[:, :1]).all()
        assert state.parameter.shape == (4, LANES)
        return state.parameter[:, 0].tolist()

    assert step(PROJECTED, config) == pytest.approx([0.7, 0.2, 0.5, 0.5001])
    assert step(PROJECTED, replace(config, multiplier_lr=0.5))[1] == 0.0
    assert step(
        SOFTPLUS, Config(initial_multiplier=0.0, multiplier_lr=0.1, multiplier_optimizer="sgd")
    )[0] == pytest.approx(0.1)
    by_adam = step(PROJECTED, replace(config, multiplier_optimizer="adam"))
    assert by_adam == pytest.approx([0.6, 0.4, 0.5, 0.6], abs=1e-5)


def test_ten_steps_of_pid_by_hand():
    """k_P = ½, k_I = 0.1, k_D = 2, d = 4, from λ = 0.3; the averages start at 0.

    First, cost 4: Δ = 0, I = 0.3, c = 0.05·4 = 0.2, λ = 0 + 0.3 + 2·0.2 = 0.7. Second, cost 8:
    Δ = 4, I = 0.7, c = 0.19 + 0.4 = 0.59, λ = 2 + 0.7 + 2·0.39 = 3.48. Third, cost 0: Δ = -4,
    I = 0.3, c falls, λ = (-2 + 0.3)₊ = 0. Fourth, cost 6: Δ = 2, I = 0.5, c = 0.532475 + 0.3, which
    is 0.271975 more, λ = 1 + 0.5 + 0.54395 = 2.04395; and so on.
    """
    config = Config(0.5, 0.1, 2.0, initial_multiplier=0.3, multiplier_optimizer="pid")
    costs = [4.0, 8.0, 0.0, 6.0, 20.0, 20.0, 3.0, 0.0, 0.0, 10.0]
    expected = [0.7, 3.48, 0.0, 2.04395, 12.016753, 13.520915, 3.129869, 1.2, 0.8, 7.154859]
    state, found = lagrange.initial(PROJECTED, config, 2), []
    assert lagrange.value(PROJECTED, state, 2).tolist() == [[pytest.approx(0.3)]] * 2
    for cost in costs:
        # The second run's costs are always 0: its integral falls to 0 and no further.
        state = lagrange.follow(PROJECTED, config, state, torch.tensor([[cost], [0.0]]))
        found.append(lagrange.value(PROJECTED, state, 2).flatten().tolist())
    assert [value for value, _ in found] == pytest.approx(expected, abs=1e-5)
    assert [value for _, value in found] == [0.0] * 10
    assert state.integral[:, 0].tolist() == [pytest.approx(3.4), 0.0]
    assert state.smoothed_cost[0].tolist() == [pytest.approx(2.828839)] * LANES


@pytest.mark.parametrize("name", FORMS)
def test_every_optimizer_starts_from_the_same_multiplier(name):
    values = {
        lagrange.value(FORMS[name], lagrange.initial(FORMS[name], config, 1), 1).item()
        for config in (
            Config(initial_multiplier=0.7, multiplier_lr=0.1, multiplier_optimizer=optimizer)
            for optimizer in ("adam", "sgd", "pid")
        )
    }
    assert len(values) == 1


def test_a_law_by_hand():
    """λ ← λ·(1 + 0.1 (c - 4)) from 0.5: 0.5·1.2 = 0.6, 0.5·0.7 = 0.35; a cost of -8 gives
    0.5·(1 - 1.2) < 0, which is projected to 0."""

    @dataclass(frozen=True)
    class Limited:
        initial_multiplier: float = 0.5
        cost_limit: float = 4.0

    def law(config, parameter, cost):
        return parameter * (1.0 + 0.1 * (cost - config.cost_limit))

    form, cost = PROJECTED._replace(law=law), torch.tensor([[6.0], [1.0], [-8.0]])
    state = lagrange.follow(form, Limited(), lagrange.initial(form, Limited(), 3), cost)
    assert lagrange.value(form, state, 3).flatten().tolist() == pytest.approx([0.6, 0.35, 0.0])
    assert state.parameter.shape == (3, LANES)
    with pytest.raises(TypeError, match=r"the multiplier has a law: .* must not have an optimizer"):
        lagrange.initial(form, Config(), 3)


def test_an_algorithm_without_one():
    assert lagrange.initial(None, None, 3) is None
    assert lagrange.value(None, None, 3).tolist() == [[0.0]] * 3
    assert lagrange.follow(None, None, None, COST) is None


def test_what_is_not_allowed():
    with pytest.raises(
        UserError, match="multiplier_optimizer must be adam or sgd or pid, got 'rms'"
    ):
        TRPOLagConfig(multiplier_optimizer="rms")
    with pytest.raises(UserError, match="initial_multiplier must be at least 0, got -1"):
        TRPOLagConfig(initial_multiplier=-1)
    with pytest.raises(UserError, match=r"pid_ki must be at least 0 and .*, got -1"):
        TRPOLagConfig(pid_ki=-1)
    for config in (CPOConfig, SACLBConfig):
        with pytest.raises(TypeError, match="multiplier_optimizer"):
            config(multiplier_optimizer="pid")
