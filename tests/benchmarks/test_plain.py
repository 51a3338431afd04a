"""Lockstep training against the plain loops of `benchmarks/`, which share no code with it.

Both start from the same parameters, get the same data, and must end with the same parameters.
"""

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from agents import trust_region as trpo
from agents.algorithms import ALGORITHMS, learner
from agents.lockstep.noise import Purpose, stream
from agents.lockstep.rollout import Rollout
from agents.on_policy.epoch import Packing
from agents.presets import preset
from agents.sac import update as sac
from agents.sac.replay import Batch

TASK, EPISODES = "Circle2D-1-v0", 10


def plain_module(name):
    path = Path(__file__).parents[2] / "benchmarks" / f"{name}.py"
    spec = importlib.util.spec_from_file_location(name, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


plain_sac, plain_trpo = plain_module("plain_sac"), plain_module("plain_trpo")


def double(tree):
    """Convert all arrays of a tree to float64."""
    if isinstance(tree, np.ndarray):
        return tree.astype(float)
    if tree is None or isinstance(tree, Tensor):
        return tree if tree is None else tree.double()
    return type(tree)(*map(double, tree)) if hasattr(tree, "_fields") else tuple(map(double, tree))


def views(module, vector):
    """Yield each parameter of a module with the view of the flat vector that corresponds to it."""
    start = 0
    for linear in (m for m in module.modules() if isinstance(m, nn.Linear)):
        n_out, n_in = linear.weight.shape
        yield linear.weight, vector[start : start + n_in * n_out].view(n_in, n_out).T
        yield linear.bias, vector[start + n_in * n_out :][:n_out]
        start += n_in * n_out + n_out


def load(module, vector):
    for parameter, view in views(module, vector):
        parameter.data = view.clone(memory_format=torch.contiguous_format)


def assert_same(module, vector, **tolerance):
    for parameter, view in views(module, vector):
        torch.testing.assert_close(parameter.data, view, **tolerance)


def networks(agent, state, run):
    """Yield every network of a plain SAC agent with its parameters in the lockstep state."""
    yield agent.actor, torch.from_numpy(state.actor[run])
    for reward, cost, flat in (
        (agent.critic, agent.cost_critic, torch.from_numpy(state.critics[run])),
        (agent.critic_target, agent.cost_target, torch.from_numpy(state.targets[run])),
    ):
        yield from zip((reward.first, reward.second, cost.first, cost.second), flat, strict=True)


def off_policy_agent(name, config, state, run):
    agent = plain_sac.AGENTS[name](run)
    agent.cost_limit = config.cost_limit
    for network, flat in networks(agent, state, run):
        load(network, flat)
    for number in (agent.log_alpha, agent.raw_multiplier):
        number.data = number.data.double()
    return agent


@pytest.mark.parametrize("name", plain_sac.AGENTS)
def test_off_policy_updates(name):
    """Three updates of two runs, in float64. The limit lies among the cost critics' values, so that
    both branches of the barrier are used."""
    rule, runs = ALGORITHMS[name].rule, 2
    config = replace(preset(name, TASK), cost_limit=0.1)
    nets = sac.make_nets(config, 2, 2, 1)
    state = double(sac.initial_state(nets, config, rule, range(runs)))
    generator = torch.Generator().manual_seed(0)
    shift = 0.1 * torch.randn(state.targets.shape, generator=generator).double()
    state = state._replace(targets=state.targets + shift.numpy())
    agents = [off_policy_agent(name, config, state, run) for run in range(runs)]
    for k in range(3):
        rows = torch.rand(runs, 256, 9, generator=generator).double()
        rows[..., [5, 8]] = rows[..., [5, 8]].round()  # cost and end
        obs, action, reward, cost, obs2, end = rows.split([2, 2, 1, 1, 2, 1], dim=-1)
        ends = end[..., 0], end[..., 0]
        columns = (obs, action, reward[..., 0], cost.mT, obs2, *ends)
        batch = Batch(*(column.numpy() for column in columns))
        noises, losses = [], []
        for run, agent in enumerate(agents):
            torch.manual_seed(100 * k + run)
            noises.append(torch.stack([torch.randn_like(obs2[run]) for _ in range(2)]))
            torch.manual_seed(100 * k + run)  # so that the plain loop draws the same
            losses.append(torch.stack(agent.learn(rows[run])))
        noise = sac.UpdateNoise(*torch.stack(noises, dim=1).numpy())
        state, metrics = sac.update(nets, config, rule, state, batch, noise)
        found = metrics["critic_loss"] + metrics["cost_critic_loss"], metrics["actor_loss"]
        np.testing.assert_allclose(np.stack(found, axis=1), torch.stack(losses), rtol=0, atol=1e-9)
    for run, agent in enumerate(agents):
        for network, flat in networks(agent, state, run):
            assert_same(network, flat, rtol=0, atol=1e-9)
        numbers = [(agent.log_alpha, state.log_temperature)]
        assert agent.has_multiplier == len(state.multipliers)
        if agent.has_multiplier:
            numbers.append((agent.raw_multiplier, state.multipliers[0].parameter))
        for plain, ours in numbers:
            assert plain.item() == pytest.approx(ours[run, 0], rel=0, abs=1e-9)
            assert plain.abs() > 1e-4  # it has moved


def invented_rollout(runs):
    """Return a rollout of invented episodes of different lengths, from random numbers."""
    rng, n = np.random.default_rng(0), runs * EPISODES
    length = rng.integers(30, 51, size=n)
    path = np.cumsum(0.1 * rng.normal(size=(51, n, 2)), axis=0).astype(np.float32)
    action = rng.normal(size=(50, n, 2)).astype(np.float32)
    reward = (action[..., 0] - np.abs(path[1:]).sum(axis=-1)).astype(np.float64)
    cost = (path[1:, :, 0] + 0.3 * action[..., 0] > 0.3).astype(np.float64)
    never, ends = np.zeros((50, n), dtype=bool), np.arange(50)[:, None] == length - 1
    columns = path[:-1], action, reward, cost[..., None], path[1:], never, ends
    return Rollout(*columns, length, np.full(n, ""))


def on_policy_agent(name, it, run):
    agent = plain_trpo.AGENTS[name](0)
    agent.rng = stream(run, Purpose.UPDATE, 0)
    load(agent.actor, it._state.actor[run])
    for k, critic in enumerate(agent.critics):
        load(critic, it._state.critics[run, k])
    return agent


def assert_same_actor(agent, it, params, **tolerance):
    start = it.nets.actor.net.size
    assert_same(agent.actor, params, **tolerance)
    torch.testing.assert_close(agent.actor.log_std.data, params[start : start + 2], **tolerance)


@pytest.mark.parametrize("name", plain_trpo.AGENTS)
@pytest.mark.parametrize("target_kl", [0.01, 1.0])
def test_policy_steps(name, target_kl):
    """In float64. Runs 0 to 3 have an excess cost for each case of CPO; in the others the cost
    advantage is 0, equal to the reward advantage, and its opposite. With `target_kl` 1 the trust
    region is far too large for its quadratic model, so that the line search must shrink steps."""
    it = learner(name, replace(preset(name, TASK), target_kl=target_kl), range(7), 2, 2)
    rollout = invented_rollout(7)
    packing = Packing(rollout.during, 7)
    epoch = double(it._epoch(rollout, packing))
    excess = torch.tensor([-20, -1, 1, 20, 1, 1, -1]).double() * (100 * target_kl) ** 0.5
    for run, factor in ((4, 0.0), (5, 1.0), (6, -1.0)):
        epoch.cost_advantage[run, 0] = factor * epoch.reward_advantage[run]
    cost = excess[:, None] + it.config.cost_limit
    epoch, state = epoch._replace(cost=cost), double(it._state)
    own = (it.nets, it.config, it.rule, state, epoch, packing.steps)
    params, records = trpo.policy_step(*own)
    if name == "cpo":
        assert records["case"].tolist() == [1, 2, 3, 4, 1, 3, 2]
        assert (records["step_scale"] > 0).all()
    assert (records["step_scale"] < 1).any() == (target_kl == 1.0)
    for run, steps in enumerate(packing.steps):
        agent = on_policy_agent(name, it, run)
        agent.target_kl = target_kl
        agent.actor.double()
        gains = epoch.reward_advantage, epoch.cost_advantage[:, 0]
        data = (epoch.observation, epoch.action, *gains)
        agent.policy_step(
            *(column[run, :steps] for column in data), excess[run].item(), steps / EPISODES
        )
        assert_same_actor(agent, it, params[run], rtol=0, atol=1e-7)


@pytest.mark.parametrize("name", plain_trpo.AGENTS)
def test_on_policy_epoch(name):
    """Advantages, policy step, critics and multiplier of an epoch, in float32 as in training."""
    it, rollout = learner(name, preset(name, TASK), range(2), 2, 2), invented_rollout(2)
    agents = [on_policy_agent(name, it, run) for run in range(2)]
    it.learn(rollout, 0, np.ones(2, dtype=bool))
    for run, agent in enumerate(agents):
        episodes = []
        for k in range(run * EPISODES, (run + 1) * EPISODES):
            steps = slice(rollout.length[k])
            path = [rollout.observation[steps, k], rollout.next_observation[steps, k][-1:]]
            columns = rollout.action, rollout.reward, rollout.cost[..., 0]
            others = (part[steps, k] for part in columns)
            episodes.append((np.concatenate(path), *others))
        agent.learn(episodes)
        assert_same_actor(agent, it, it._state.actor[run], rtol=0, atol=1e-5)
        for k, critic in enumerate(agent.critics):
            assert_same(critic, it._state.critics[run, k], rtol=0, atol=1e-6)
        if agent.has_multiplier:
            found = it._state.multipliers[0].parameter[run, 0]
            assert agent.multiplier.item() == pytest.approx(found, rel=1e-5)
