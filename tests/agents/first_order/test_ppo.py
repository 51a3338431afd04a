"""The clipped surrogate by hand; steps of Adam against PyTorch's own; runs side by side."""

import math

import numpy as np
import pytest
import torch
from modules import data, flat, module
from torch.distributions import Independent, Normal

from agents.first_order import Minibatch, PPOConfig, actor_step, clipped, surrogate_at
from agents.lockstep.nets import MLP, no_moments
from agents.on_policy.state import GaussianPolicy, Nets

CRITIC = MLP((3, 32, 1))
LINE = Nets(GaussianPolicy(MLP((1, 1))), CRITIC)
"""Mean = weight · observation + bias, in parameters 0 and 1; log-std in parameter 32."""
BIAS, LOG_STD = 1, 32


def clipped_surrogate(actor, batch):
    return surrogate_at(LINE, PPOConfig(clip_range=0.2), clipped, actor, batch)


def line(bias):
    params = torch.zeros(1, LINE.actor.size, dtype=torch.float64)
    params[0, BIAS] = bias
    return params


def five_steps():
    """Actions drawn from N(0, 1), at observation 0; advantages of both signs."""
    action = torch.tensor([[1.0, 1.0, -1.0, -1.0, 0.25]], dtype=torch.float64)
    return Minibatch(
        observation=torch.zeros(1, 5, 1, dtype=torch.float64),
        action=action[..., None],
        weight=torch.full((1, 5), 0.2, dtype=torch.float64),
        advantage=torch.tensor([[2.0, -1.0, 1.0, -1.0, 3.0]], dtype=torch.float64),
        old_log_prob=-0.5 * action**2 - 0.5 * math.log(2 * math.pi),
    )


def test_surrogate_and_its_gradient_by_hand():
    """From N(0, 1) to N(½, 1): log ρ = a/2 - 1/8, so ρ = 1.4549914 at a = 1, 0.5352614 at -1 and 1
    at ¼; ε = 0.2. The slope of ρ A is ρ A (a - ½) along the mean, ρ A ((a - ½)² - 1) along log σ.

    a = 1, A = 2: clipped to 1.2·2 = 2.4, slopes 0.
    a = 1, A = -1: -1.4549914 is less than -1.2 and stays; slopes -0.7274957 and 1.0912436.
    a = -1, A = 1: 0.5352614 is less than 0.8 and stays; slopes -0.8028921 and 0.6690768.
    a = -1, A = -1: clipped to -0.8, slopes 0.
    a = ¼, A = 3: 3; slopes -0.75 and -2.8125.
    """
    at = line(0.5)
    found, outside = clipped_surrogate(at, five_steps())
    assert found.item() == pytest.approx((2.4 - 1.4549914 + 0.5352614 - 0.8 + 3.0) / 5, abs=1e-7)
    assert outside.item() == pytest.approx(4 / 5)
    slope = torch.func.grad(lambda p: clipped_surrogate(p, five_steps())[0].sum())(at)
    assert slope[0, BIAS].item() == pytest.approx((-0.7274957 - 0.8028921 - 0.75) / 5, abs=1e-7)
    by_hand = (1.0912436 + 0.6690768 - 2.8125) / 5
    assert slope[0, LOG_STD].item() == pytest.approx(by_hand, abs=1e-6)
    assert slope[0, 0] == 0  # the weight's: all observations are 0


def test_rows_of_weight_zero_do_not_count():
    """Not even one whose ratio overflows."""
    step = five_steps()
    far = step._replace(
        weight=torch.tensor([[0.25, 0.25, 0.25, 0.25, 0.0]], dtype=torch.float64),
        old_log_prob=torch.where(torch.arange(5) == 4, -1e9, step.old_log_prob),
    )
    without = Minibatch(*(part[:, :4] for part in far[:5]))
    for of in (0, 1):
        found = clipped_surrogate(line(0.5), far)[of]
        torch.testing.assert_close(found, clipped_surrogate(line(0.5), without)[of])


@pytest.mark.parametrize("longest", [0.05, 1e9])
def test_steps_of_adam_against_separate_runs(longest):
    """Three steps of two runs; the second has no rows in the second minibatch, and waits."""
    nets = Nets(GaussianPolicy(MLP((3, 32, 2))), CRITIC)
    config = PPOConfig(max_gradient_norm=longest, learning_rate=1e-2)
    rng = np.random.default_rng(0)
    actor = torch.from_numpy(np.stack([nets.actor.initial(rng, -0.5) for _ in range(2)]))
    start, moments = nets.actor.net.size, no_moments(actor)
    theirs = [module(nets.actor.net, params) for params in actor]
    log_stds = [params[start : start + 2].double().requires_grad_() for params in actor]
    own = [[*net.parameters(), s] for net, s in zip(theirs, log_stds, strict=True)]
    optimizers = [torch.optim.Adam(parameters, lr=1e-2) for parameters in own]
    for held in torch.tensor([[32, 20], [32, 0], [9, 32]]):
        columns = torch.from_numpy(rng.normal(size=(2, 32, 7)).astype(np.float32))
        weight = (torch.arange(32) < held[:, None]) / held[:, None].clamp(min=1)
        observation, action, gain, before = columns.split((3, 2, 1, 1), dim=-1)
        batch = Minibatch(observation, action, weight, gain[..., 0], before[..., 0] / 3 - 2.5)
        actor, moments, _ = actor_step(nets, config, actor, moments, batch)
        for run, n in enumerate(held):
            if n == 0:
                continue
            mean = theirs[run](batch.observation[run, :n].double())
            policy = Independent(Normal(mean, log_stds[run].exp().expand_as(mean)), 1)
            ratio = (policy.log_prob(batch.action[run, :n]) - batch.old_log_prob[run, :n]).exp()
            gains = batch.advantage[run, :n]
            loss = -torch.minimum(ratio * gains, ratio.clamp(0.8, 1.2) * gains).mean()
            optimizers[run].zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(own[run], longest)
            optimizers[run].step()
    for run in range(2):
        expected = flat(nets.actor.net, theirs[run], data)
        found = actor[run, :start].double()
        torch.testing.assert_close(found, expected, rtol=0, atol=2e-5)
        log_std = actor[run, start : start + 2].double()
        torch.testing.assert_close(log_std, log_stds[run].detach(), rtol=0, atol=2e-5)
