"""SAC-LB tuned, beside SAC-LB."""

import dataclasses

import pytest
import torch

from agents.algorithms import algorithm
from agents.algorithms.sac_lb_tuned import RULE, SACLBTunedConfig
from agents.errors import UserError
from agents.paper.presets import preset


def test_the_barrier_stands_below_the_limit():
    """Limit 5, margin .4: at a risk of 2 the barrier is -log(3 - 2) / 3 = 0, at 0 -log(3) / 3."""
    config = SACLBTunedConfig(cost_limit=5.0, margin=0.4)
    risk = torch.tensor([[2.0, 0.0]], dtype=torch.float64)
    found = RULE.penalty(config, risk, torch.zeros(1, 1))
    assert found[0].tolist() == pytest.approx([0.0, -1.0986123 / 3], abs=1e-7)


def test_without_its_changes_it_is_sac_lb():
    plain = algorithm("sac-lb")
    shared = {f.name: f.default for f in dataclasses.fields(plain.config)}
    config = SACLBTunedConfig(**shared, margin=0.0)
    risk = torch.linspace(-3.0, 40.0, 50)[None]
    none = torch.zeros(1, 1)
    expected = plain.rule.penalty(plain.config(**shared), risk, none)
    torch.testing.assert_close(RULE.penalty(config, risk, none), expected, rtol=0, atol=0)
    assert (RULE.risk, RULE.critic_loss) == (plain.rule.risk, plain.rule.critic_loss)


def test_one_set_of_hyper_parameters_for_all_levels():
    presets = [preset("sac-lb-tuned", f"Circle2D-{level}-v0") for level in range(4)]
    assert presets == [presets[0]] * 4
    assert presets[0].cost_limit == 5.0
    assert presets[0] == preset("sac-lb-tuned", "Circle2DMuJoCo-0-v0")


@pytest.mark.parametrize("margin", [-0.1, 1.0, float("nan")])
def test_margins_that_cannot_be(margin):
    with pytest.raises(UserError, match="margin"):
        SACLBTunedConfig(margin=margin)
