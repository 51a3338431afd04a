"""The SAC family's losses by hand. Whole updates are compared with a plain loop in
`tests/benchmarks`, and with another library in `test_stable_baselines`."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from agents.algorithms.sac_lag import RULE, SACLagConfig
from agents.lockstep import lagrange, tree
from agents.sac import OffPolicy
from agents.sac import update as sac
from agents.sac.replay import Batch

CONFIG = SACLagConfig(cost_limit=5.0, discount=0.9, multiplier_lr=2e-3)


def two_transitions():
    return Batch(
        observation=np.zeros((1, 2, 2), np.float32),
        action=np.zeros((1, 2, 2), np.float32),
        reward=np.float32([[1.0, -2.0]]),
        cost=np.float32([[[0.0, 1.0]]]),
        next_observation=np.zeros((1, 2, 2), np.float32),
        terminal=np.float32([[0.0, 1.0]]),
        cost_terminal=np.float32([[0.0, 1.0]]),
    )


def constant_nets(config, values, targets):
    """Return nets whose weights are 0: a critic's value is its last bias; the actor's mean and
    log-std are 0."""
    nets = sac.make_nets(config, 2, 2, 1)
    state = sac.initial_state(nets, config, RULE, [0])
    critics, slow = np.zeros((2, 1, 4, nets.critic.size), np.float32)
    last = sum(a * b + b for a, b in ((4, 64), (64, 64))) + 64  # where the output's bias lies
    critics[0, :, last], slow[0, :, last] = values, targets
    return nets, state._replace(actor=0 * state.actor, critics=critics, targets=slow)


def test_losses_by_hand():
    """Two transitions: r = 1, -2; c = 0, 1; the second is terminal; γ = 0.9; α = 1; β = ln 2.

    The reward critics' values are 3 and 4, those of their target networks 2 and 1.5; the cost
    critics' are 6 and 7, with targets 8 and 9. The actor's mean is 0 and its standard deviation 1;
    with noise 0, a = 0 and log π = -½ ln 2π - 2 (ln 2 - 0 - ln 2) = -0.9189385 per component, in
    sum -1.8378771.
    """
    config = replace(CONFIG, learning_rate=1e-12)  # the actor's loss is after the critics' step
    nets, state = constant_nets(config, [3.0, 4.0, 6.0, 7.0], [2.0, 1.5, 8.0, 9.0])
    noise = sac.UpdateNoise(*np.zeros((2, 1, 2, 2), np.float32))
    log_prob = -math.log(2 * math.pi)
    _, found = sac.update(nets, config, RULE, state, two_transitions(), noise)
    # targets: 1 + 0.9 (min(2, 1.5) + 1.8378771) = 4.0040894, and -2, the terminal one's reward;
    # ½ mean[(3 - 4.0040894)², (3 + 2)²] + ½ mean[(4 - 4.0040894)², (4 + 2)²]
    # = ½ (1.0081955 + 25) / 2 + ½ (0.0000167 + 36) / 2 = 6.5020489 + 9.0000042
    assert found["critic_loss"].item() == pytest.approx(15.5020531, rel=1e-6)
    # cost targets: 0 + 0.9 · max(8, 9) = 8.1 and 1 (terminal)
    # ½ mean[(6 - 8.1)², (6 - 1)²] + ½ mean[(7 - 8.1)², (7 - 1)²]
    # = ½ (4.41 + 25) / 2 + ½ (1.21 + 36) / 2 = 7.3525 + 9.3025
    assert found["cost_critic_loss"].item() == pytest.approx(16.655, rel=1e-6)
    assert found["risks"].tolist() == [[7.0]]
    assert found["entropy"].item() == pytest.approx(-log_prob, rel=1e-6)
    # α log π - min Q + β max Q_c = -1.8378771 - 3 + 0.6931472 · 7 = 0.0141533
    assert found["actor_loss"].item() == pytest.approx(0.0141533, abs=1e-6)


@pytest.mark.parametrize(("first", "loss"), [(8.0, 15.9125), (-8.0, 24.5525)])
def test_the_mean_of_the_cost_critics_by_hand(first, loss):
    """`test_losses_by_hand` with the mean of the cost critics, each of which has its own target.

    Targets of the first: 0.9 · 8 = 7.2 or, for a negative next value, 0; and 1. Of the second: 0.9
    · 9 = 8.1 and 1. ½ mean[(6 - 7.2)², (6 - 1)²] + ½ mean[(7 - 8.1)², (7 - 1)²] = 6.61 + 9.3025; or
    ½ mean[6², 5²] + 9.3025 = 24.5525. The actor's loss: -1.8378771 - 3 + 0.6931472 · 6.5.
    """
    config = replace(CONFIG, cost_estimate="mean", learning_rate=1e-12)
    nets, state = constant_nets(config, [3.0, 4.0, 6.0, 7.0], [2.0, 1.5, first, 9.0])
    noise = sac.UpdateNoise(*np.zeros((2, 1, 2, 2), np.float32))
    _, found = sac.update(nets, config, RULE, state, two_transitions(), noise)
    assert found["cost_critic_loss"].item() == pytest.approx(loss, rel=1e-6)
    assert found["risks"].tolist() == [[6.5]]
    assert found["actor_loss"].item() == pytest.approx(-0.3324203, abs=1e-6)


def test_step_sizes_of_actor_and_temperature():
    """The first step of Adam changes each parameter with a gradient by its step size."""
    config = replace(CONFIG, policy_lr=1e-2, temperature_lr=0.0, initial_temperature=0.5)
    nets, state = constant_nets(config, [3.0, 4.0, 6.0, 7.0], [2.0, 1.5, 8.0, 9.0])
    before = tree.copy(state)
    noise = sac.UpdateNoise(*np.ones((2, 1, 2, 2), np.float32))
    after, found = sac.update(nets, config, RULE, state, two_transitions(), noise)
    for name, rate in (("actor", 1e-2), ("critics", 3e-4)):
        change = np.abs(getattr(after, name) - getattr(before, name))
        assert change.max() == pytest.approx(rate, rel=1e-3)
    assert found["temperature"].item() == pytest.approx(0.5)
    np.testing.assert_array_equal(after.log_temperature, before.log_temperature)


@pytest.mark.parametrize("scale", [0.1, 1.0, 3.0])
def test_squashed_gaussian_against_torch_distributions(scale):
    generator = torch.Generator().manual_seed(0)
    outputs = (scale * torch.randn(2, 50, 6, generator=generator)).double()
    noise = torch.randn(2, 50, 3, generator=generator).double()
    drawn = sac.sampled(outputs.numpy(), noise.numpy())
    action, log_prob = torch.tensor(drawn.action).movedim(0, -1), torch.tensor(drawn.log_prob)
    mean, log_std = outputs.chunk(2, dim=-1)
    distribution = torch.distributions.TransformedDistribution(
        torch.distributions.Normal(mean, log_std.clamp(-20, 2).exp()),
        torch.distributions.TanhTransform(cache_size=1),
    )
    u = mean + log_std.clamp(-20, 2).exp() * noise
    keep = u.abs() < 8  # beyond, atanh(tanh(u)) has lost u
    expected = distribution.log_prob(torch.tanh(u).clamp(-1 + 1e-15, 1 - 1e-15))
    torch.testing.assert_close(action, torch.tanh(u))
    rows = keep.all(dim=-1)
    assert rows.float().mean() > 0.3
    torch.testing.assert_close(log_prob[rows], expected.sum(dim=-1)[rows], rtol=1e-5, atol=1e-5)
    in_numpy = sac.act(outputs.numpy(), noise.numpy())
    np.testing.assert_allclose(in_numpy, action.numpy(), rtol=1e-12, atol=1e-12)
    deterministic = sac.act(outputs.numpy(), None)
    np.testing.assert_allclose(deterministic, torch.tanh(mean).numpy())


def test_every_critic_has_initial_parameters_of_its_own():
    """Twins that start alike would stay alike, and their minimum would be the value of either."""
    nets = sac.make_nets(CONFIG, 3, 2, 1)
    critics = sac.initial_state(nets, CONFIG, RULE, (0, 1)).critics
    assert len({critic.tobytes() for of_run in critics for critic in of_run}) == 2 * 4


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"penalty": lambda config, risk, m: m * risk[:, 0]}, r"penalty must return .*\[2, 3\]"),
        ({"multipliers": ()}, r"penalty must return \[2, 1, 3\], got \[2, 0, 3\]"),
        ({"critic_loss": lambda *_: torch.zeros(())}, r"critic_loss must return \[2\], got \[\]"),
        ({"risk": lambda config, values: values}, r"risk must return \[2, 3\], got \[2, 2, 3\]"),
        ({"augmented": lambda config, m, risk: m.sum()}, r"augmented must return \[2, 1\]"),
    ],
)
def test_a_rule_that_returns_other_shapes_is_refused(changed, message):
    """Before training, since a sum over the wrong axis would go unnoticed."""
    with pytest.raises(ValueError, match=message):
        OffPolicy(SACLagConfig(), RULE._replace(**changed), (0, 1, 2), 2, 1)


def test_a_law_that_returns_another_shape_is_refused():
    law = lagrange.PROJECTED._replace(law=lambda config, parameter, cost: cost[:, 0])
    with pytest.raises(ValueError, match=r"must return \[3, 32\] or \[3, 1\], got \[3\]"):
        lagrange.initial((lagrange.Multiplier(law),), sac.ConstrainedSACConfig(), 3)
