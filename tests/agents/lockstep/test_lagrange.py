"""The updates of multipliers, by hand, for each form and optimizer."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from agents.lockstep import lagrange
from agents.lockstep.lagrange import EXP, PROJECTED, SOFTPLUS, Multiplier, MultiplierConfig
from agents.lockstep.nets import LANES

FORMS = {"softplus": SOFTPLUS, "exp": EXP, "projected": PROJECTED}


@dataclass(frozen=True)
class Config(MultiplierConfig):
    """Hyper-parameters of multipliers with two limits."""

    cost_limit: float = 4.0
    second_limit: float = 7.0


class One:
    """The multiplier of some runs."""

    def __init__(self, form, config, runs):
        self.rule, self.config, self.runs = (Multiplier(form),), config, runs
        (self.state,) = lagrange.initial(self.rule, config, runs)

    @property
    def value(self):
        return lagrange.values(self.rule, (self.state,), self.runs).flatten().tolist()

    def follow(self, cost):
        (self.state,) = lagrange.follow(self.rule, self.config, (self.state,), cost)
        return self


COST = 4.0 + np.array([[2.0], [-3.0], [0.0], [1e-3]])


@pytest.mark.parametrize("name", FORMS)
@pytest.mark.parametrize("optimizer", ["adam", "sgd"])
def test_rises_exactly_when_the_cost_is_above_the_limit(name, optimizer):
    config = Config(initial_multiplier=1.5, multiplier_lr=1e-2, multiplier_optimizer=optimizer)
    one = One(FORMS[name], config, 4)
    before = np.array(one.value)
    change = np.array(one.follow(COST).value) - before
    assert np.sign(change).tolist() == [1.0, -1.0, 0.0, 1.0]


@pytest.mark.parametrize("name", FORMS)
def test_the_slope_of_a_form_against_finite_differences(name):
    h, form = 1e-6, FORMS[name]
    at = np.array([-30.0, 0.1, 0.7, 3.0])
    expected = (form.value(at + h) - form.value(at - h)) / (2 * h)
    np.testing.assert_allclose(form.slope(at), expected, rtol=1e-6, atol=1e-8)


def test_steps_of_sgd_and_adam_by_hand():
    """SGD from λ = 0.5 at lr 0.1: 0.5 + 0.1·2 = 0.7 and 0.5 - 0.1·3 = 0.2; at lr 0.5 the second is
    -1, which is projected to 0. Softplus has the slope ½ at 0, so 0 + 0.1·½·2 = 0.1. The first step
    of Adam has the size of its learning rate."""
    config = Config(initial_multiplier=0.5, multiplier_lr=0.1, multiplier_optimizer="sgd")

    def step(form, config):
        state = One(form, config, 4).follow(COST).state
        assert (state.parameter == state.parameter[:, :1]).all()
        assert state.parameter.shape == (4, LANES)
        return state.parameter[:, 0].tolist()

    assert step(PROJECTED, config) == pytest.approx([0.7, 0.2, 0.5, 0.5001])
    assert step(PROJECTED, replace(config, multiplier_lr=0.5))[1] == 0.0
    assert step(SOFTPLUS, replace(config, initial_multiplier=0.0))[0] == pytest.approx(0.1)
    by_adam = step(PROJECTED, replace(config, multiplier_optimizer="adam"))
    assert by_adam == pytest.approx([0.6, 0.4, 0.5, 0.6], abs=1e-5)


def test_ten_steps_of_pid_by_hand():
    """k_P = ½, k_I = 0.1, k_D = 2, d = 4, from λ = 0.3; the smoothed cost c starts at 0.

    1. Cost 4: Δ = 0, I = 0.3, c = 0.05·4 = 0.2, λ = 0 + 0.3 + 2·0.2 = 0.7.
    2. Cost 8: Δ = 4, I = 0.7, c = 0.19 + 0.4 = 0.59, λ = 2 + 0.7 + 2·0.39 = 3.48.
    3. Cost 0: Δ = -4, I = 0.3, c falls, λ = (-2 + 0.3)₊ = 0.
    4. Cost 6: Δ = 2, I = 0.5, c = 0.532475 + 0.3 = 0.832475, a rise of 0.271975,
       λ = 1 + 0.5 + 0.54395 = 2.04395; and so on.
    """
    config = Config(0.5, 0.1, 2.0, initial_multiplier=0.3, multiplier_optimizer="pid")
    costs = [4.0, 8.0, 0.0, 6.0, 20.0, 20.0, 3.0, 0.0, 0.0, 10.0]
    expected = [0.7, 3.48, 0.0, 2.04395, 12.016753, 13.520915, 3.129869, 1.2, 0.8, 7.154859]
    one, found = One(PROJECTED, config, 2), []
    assert one.value == [pytest.approx(0.3)] * 2
    for cost in costs:
        # The second run's costs are always 0, so its integral falls to 0 and stays there.
        found.append(one.follow(np.array([[cost], [0.0]])).value)
    assert [value for value, _ in found] == pytest.approx(expected, abs=1e-5)
    assert [value for _, value in found] == [0.0] * 10
    assert one.state.integral[:, 0].tolist() == [pytest.approx(3.4), 0.0]
    assert one.state.smoothed_cost[0].tolist() == [pytest.approx(2.828839)] * LANES


def test_a_user_defined_law_by_hand():
    """λ ← λ·(1 + 0.1 (c - 4)) from 0.5: 0.5·1.2 = 0.6, 0.5·0.7 = 0.35; a cost of -8 gives
    0.5·(1 - 1.2) < 0, which is projected to 0."""

    @dataclass(frozen=True)
    class Limited:
        initial_multiplier: float = 0.5
        cost_limit: float = 4.0

    def law(config, parameter, cost):
        return parameter * (1.0 + 0.1 * (cost - config.cost_limit))

    form, cost = PROJECTED._replace(law=law), np.array([[6.0], [1.0], [-8.0]])
    one = One(form, Limited(), 3).follow(cost)
    assert one.value == pytest.approx([0.6, 0.35, 0.0])
    assert one.state.parameter.shape == (3, LANES)
    with pytest.raises(TypeError, match="must not have an optimizer"):
        One(form, Config(), 3)


def test_several_multipliers_follow_their_own_costs_and_limits():
    """SGD at lr 0.1 from 0.5, in a run with the costs 5 and 10.

    The first multiplier limits cost 1 to 7: 0.5 + 0.1·(10 - 7) = 0.8. The second limits cost 0 to 4
    through softplus: 0.5 + 0.1·σ(0.5)·(5 - 4) = 0.5622459. The third limits cost 1 to 4:
    0.5 + 0.1·6 = 1.1. In a run with the costs 2 and 6 they are 0.4, 0.3755081 and 0.7.
    """
    second = Multiplier(PROJECTED, 1, "second_limit")
    rule = second, Multiplier(SOFTPLUS), Multiplier(PROJECTED, 1)
    config = Config(initial_multiplier=0.5, multiplier_lr=0.1, multiplier_optimizer="sgd")
    states = lagrange.initial(rule, config, 2)
    after = lagrange.follow(rule, config, states, np.array([[5.0, 10.0], [2.0, 6.0]]))
    found = np.stack([state.parameter[:, 0] for state in after], axis=1)
    by_hand = np.array([[0.8, 0.5622459, 1.1], [0.4, 0.3755081, 0.7]])
    np.testing.assert_allclose(found, by_hand, rtol=1e-6)
    values = lagrange.values(rule, after, 2)
    np.testing.assert_allclose(values[:, 1], np.log(1 + np.exp(by_hand[:, 1])), rtol=1e-6)
    np.testing.assert_allclose(values[:, ::2], by_hand[:, ::2], rtol=1e-6)
    assert lagrange.names(rule) == ("multiplier", "multiplier_2", "multiplier_3")


@pytest.mark.parametrize("name", FORMS)
def test_every_optimizer_starts_from_the_same_multiplier(name):
    settings = {"initial_multiplier": 0.7, "multiplier_lr": 0.1}
    optimizers = ("adam", "sgd", "pid")
    configs = [Config(multiplier_optimizer=optimizer, **settings) for optimizer in optimizers]
    assert len({*(One(FORMS[name], config, 1).value[0] for config in configs)}) == 1
