"""Policies and surrogates against PyTorch's own modules, one run at a time; TRPO-Lag."""

import math

import numpy as np
import pytest
import torch
from modules import flat, module
from small_policy import normal
from torch.distributions import Independent, Normal, kl_divergence

from agents.algorithms import trpo_lag
from agents.algorithms.trpo_lag import TRPOLagConfig
from agents.lockstep.nets import MLP
from agents.on_policy import state as on_policy
from agents.on_policy.epoch import BLOCK, Epoch, blocks_of, compared
from agents.on_policy.state import GaussianPolicy
from agents.trust_region import Problem

OBSERVATION, ACTION = 3, 2
SMALL = {"hidden": (32,), "episodes": 2, "critic_iterations": 2}
ACTOR = GaussianPolicy(MLP((OBSERVATION, 32, ACTION)))
NETS = on_policy.Nets(ACTOR, MLP((OBSERVATION, 32, 1)))
LAG = trpo_lag.RULE.multipliers


class Separate:
    """One run's policy with PyTorch's modules and distributions."""

    def __init__(self, params):
        self.net = module(ACTOR.net, params)
        start = ACTOR.net.size
        self.log_std = params[start : start + ACTION].clone().requires_grad_()

    def at(self, observation):
        mean = self.net(observation)
        return Independent(Normal(mean, self.log_std.exp().expand_as(mean)), 1)


def random_actor(runs, seed=0):
    return 0.3 * normal(runs, ACTOR.size, seed=seed)


def random_epoch(steps, size):
    """Rows beyond a run's steps are not 0: only their weight keeps them out."""
    runs, steps = len(steps), torch.tensor(steps)
    columns = normal(runs, size, OBSERVATION + ACTION + 2, seed=1)
    observation, action, advantages = columns.split((OBSERVATION, ACTION, 2), dim=-1)
    return Epoch(
        observation=observation,
        action=action,
        weight=(torch.arange(size) < steps[:, None]) / steps[:, None].double(),
        reward_advantage=advantages[..., 0],
        cost_advantage=advantages[..., 1:].mT,
        value_targets=normal(runs, 2, size, seed=2),
        length=torch.full((runs,), 50.0),
        cost=torch.zeros(runs, 1),
    )


def test_distribution_against_torch():
    params, others = random_actor(3), random_actor(3, seed=5)
    observation, action = normal(3, 7, OBSERVATION, seed=1), normal(3, 7, ACTION, seed=2)
    found = ACTOR.distribution(params, observation)
    log_prob, kl = found.log_prob(action), found.kl(ACTOR.distribution(others, observation))
    one = np.ones((), np.float32)
    acted = ACTOR.act(params.numpy(), one, observation.numpy(), action.numpy())  # action: the noise
    deterministic = ACTOR.act(params.numpy(), one, observation.numpy(), None)
    for run in range(3):
        theirs = Separate(params[run]).at(observation[run])
        other = Separate(others[run]).at(observation[run])
        torch.testing.assert_close(log_prob[run], theirs.log_prob(action[run]))
        torch.testing.assert_close(kl[run], kl_divergence(theirs, other))
        by_hand = theirs.mean + theirs.stddev * action[run]
        torch.testing.assert_close(torch.from_numpy(acted[run]), by_hand)
        torch.testing.assert_close(torch.from_numpy(deterministic[run]), theirs.mean)


def test_initial_deviation():
    config = TRPOLagConfig(initial_log_std=-0.5, **SMALL)
    state = on_policy.initial_state(NETS, config, LAG, 1, [3, 4])
    policy = ACTOR.distribution(state.actor, torch.zeros(2, 1, OBSERVATION))
    torch.testing.assert_close(policy.std, torch.full((2, 1, ACTION), math.exp(-0.5)))
    assert (state.actor[:, ACTOR.net.size + ACTION :] == 0).all()
    assert (state.actor[0] != state.actor[1]).any()
    again = on_policy.initial_state(NETS, config, LAG, 1, [4])
    assert torch.equal(again.actor[0], state.actor[1])
    assert torch.equal(again.critics[0], state.critics[1])
    assert (state.critics[:, 0] != state.critics[:, 1]).any()


@pytest.mark.parametrize(("steps", "size"), [((90, 400), BLOCK), ((1000, 20), 2 * BLOCK)])
def test_compared_and_its_gradient_against_separate_runs(steps, size):
    """E[ratio · A] for both advantages, and the KL from the old to the new policy."""
    old, new, epoch = random_actor(2), random_actor(2, seed=3), random_epoch(steps, size)
    blocks = blocks_of(NETS, old, epoch, epoch.reward_advantage)
    found, kl = compared(NETS, new, blocks)
    for of, advantage in enumerate((epoch.reward_advantage, epoch.cost_advantage[:, 0])):
        gradient = torch.func.grad(lambda p, of=of: compared(NETS, p, blocks)[0][:, of].sum())
        moved = gradient(new)
        for run, n in enumerate(steps):
            before, after = Separate(old[run]), Separate(new[run])
            observation, action = epoch.observation[run, :n], epoch.action[run, :n]
            theirs, ours = before.at(observation), after.at(observation)
            ratio = ours.log_prob(action).exp() / theirs.log_prob(action).exp().detach()
            surrogate = (ratio * advantage[run, :n]).mean()
            surrogate.backward()
            torch.testing.assert_close(found[run, of].double(), surrogate.detach())
            torch.testing.assert_close(kl[run].double(), kl_divergence(theirs, ours).mean())
            expected = flat(ACTOR.net, after.net)
            torch.testing.assert_close(moved[run, : ACTOR.net.size], expected)
            log_std = moved[run, ACTOR.net.size : ACTOR.net.size + ACTION]
            torch.testing.assert_close(log_std, after.log_std.grad)


def test_advantage_by_hand():
    """(A_r - λ A_c) / (1 + λ): (2 - ½·1) / 1.5 = 1, (-1 - ½·4) / 1.5 = -2; (2 - 3) / 4 = -¼."""
    reward, cost = (
        torch.tensor([[2.0, -1.0], [2.0, 0.0]]),
        torch.tensor([[[1.0, 4.0]], [[1.0, 0.0]]]),
    )
    found = trpo_lag.advantage(TRPOLagConfig(), reward, cost, torch.tensor([[0.5], [3.0]]))
    torch.testing.assert_close(found, torch.tensor([[1.0, -2.0], [-0.25, 0.0]]))


def test_step_of_trpo_by_hand():
    """H = diag(4, 1), g = (8, 1): H⁻¹g = (2, 1), of which ½ xᵀHx = 8.5; δ = 0.085 is a hundredth.

    It has to be better, and costs do not stand in its way."""
    diagonal = torch.tensor([4.0, 1.0])
    problem = Problem(
        gradient=torch.tensor([[8.0, 1.0], [0.0, 0.0]]),
        cost_gradient=lambda: pytest.fail("of no use here"),
        excess=torch.tensor([5.0, -5.0]),
        product=lambda v: diagonal * v,
        solve=lambda b: b / diagonal,
        target_kl=0.085,
    )
    found = trpo_lag.step(TRPOLagConfig(), problem)
    torch.testing.assert_close(found.displacement, torch.tensor([[0.2, 0.1], [0.0, 0.0]]))
    assert found.must_improve.all()
    assert (found.cost_bound == torch.inf).all()


def test_rows_of_weight_zero_do_not_change_a_sharp_policy():
    """At σ = e⁻⁷ the density of an action far from the mean may grow by more than e^100."""
    actor = torch.zeros(1, ACTOR.size)
    mean = sum(a * b + b for a, b in ((OBSERVATION, 32),)) + 32 * ACTION
    actor[:, mean : mean + ACTION] = 1.0
    actor[:, ACTOR.net.size : ACTOR.net.size + ACTION] = -7.0
    nearer = actor.clone()
    nearer[:, mean : mean + ACTION] = 1.0 - 2e-4
    found = []
    for size in (BLOCK, 2 * BLOCK):
        zeros = torch.zeros(1, size)
        there = (torch.arange(size) < 500).float()[None]
        epoch = Epoch(
            observation=torch.zeros(1, size, OBSERVATION),
            action=there[..., None].expand(1, size, ACTION).contiguous(),
            weight=there / 500,
            reward_advantage=there,
            cost_advantage=zeros[None],
            value_targets=torch.zeros(1, 2, size),
            length=torch.ones(1),
            cost=torch.zeros(1, 1),
        )
        steps = blocks_of(NETS, actor, epoch, epoch.reward_advantage)
        at_padding = NETS.actor.distribution(nearer, epoch.observation).log_prob(epoch.action)
        assert (at_padding - steps[0].old_log_prob[:, -1])[0, -1] > 100
        found.append(compared(NETS, nearer, steps))
    for short, long in zip(*found, strict=True):
        assert short.isfinite().all()
        assert torch.equal(short, long)
