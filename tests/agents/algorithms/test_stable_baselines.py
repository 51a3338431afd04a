"""One update of SAC and of PPO against Stable-Baselines3's, from equal weights, batch and noise.

Both compute in float32, with sums in other orders. Gradients (Adam's first moments) agree to 1e-4
of the largest in their network. Parameters agree to 2e-6 except where the gradient is almost 0,
since the first step of Adam depends on its sign alone.
"""

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.spaces import Box
from torch import nn

from agents.algorithms import learner, ppo, sac
from agents.lockstep import tree
from agents.lockstep.rollout import Rollout, learned
from agents.on_policy.epoch import Packing
from agents.sac import update
from agents.sac.replay import Batch

sb3 = pytest.importorskip("stable_baselines3")

OBSERVATION, ACTION, ROWS, HIDDEN = 3, 2, 256, (64, 64)
RATE = 3e-4


class Spaces(gym.Env):
    """Nothing but the spaces."""

    observation_space = Box(-1.0, 1.0, (OBSERVATION,))
    action_space = Box(-1.0, 1.0, (ACTION,))


def silent(model):
    model.set_logger(sb3.common.logger.configure(None, []))
    return model


def linears(*modules):
    return [m for part in modules for m in part.modules() if isinstance(m, nn.Linear)]


def put(vector, net, layers, last=()):
    """Copy our parameters of a network into theirs; last: their layers that form our last one."""
    start, sizes = 0, list(zip(net.sizes[:-1], net.sizes[1:], strict=True))
    for k, (n_in, n_out) in enumerate(sizes):
        weight = vector[start : start + n_in * n_out].reshape(n_in, n_out)
        bias = vector[start + n_in * n_out : start + (n_in + 1) * n_out]
        start += (n_in + 1) * n_out
        targets = list(last) if last and k == len(sizes) - 1 else [layers[k]]
        columns = zip(weight.chunk(len(targets), 1), bias.chunk(len(targets)), strict=True)
        for target, (part, of_bias) in zip(targets, columns, strict=True):
            target.weight.data.copy_(part.T)
            target.bias.data.copy_(of_bias)


def taken(net, layers, last=(), of=lambda parameter: parameter.data):
    """Return their parameters, or what `of` gives for each, in our order."""
    pairs = [(of(layer.weight).T, of(layer.bias)) for layer in layers[: len(net.sizes) - 2]]
    final = last or layers[len(net.sizes) - 2 :]
    weights, biases = ([of(getattr(m, p)) for m in final] for p in ("weight", "bias"))
    pairs.append((torch.cat(weights).T, torch.cat(biases)))
    return torch.cat([part.flatten() for pair in pairs for part in pair])


def average(optimizer):
    return lambda parameter: optimizer.state[parameter]["exp_avg"]


def assert_agree(found, expected, gradient, their_gradient):
    """Assert that parameters and gradients of one network agree; ours may be padded."""
    gradient, found = gradient[: len(expected)], found[: len(expected)]
    largest = their_gradient.abs().max()
    assert largest > 0
    assert (gradient - their_gradient).abs().max() < 1e-4 * largest
    clear = their_gradient.abs() > 1e-3 * largest
    assert clear.float().mean() > 0.5
    assert (found - expected).abs()[clear].max() < 2e-6
    assert (found - expected).abs().max() <= 2.1 * RATE


def test_an_update_of_sac(monkeypatch):
    rates = {"learning_rate": RATE, "temperature_lr": RATE}
    config = sac.ALGORITHM.config(batch_size=ROWS, hidden=HIDDEN, **rates)
    nets = update.make_nets(config, OBSERVATION, ACTION, 1)
    ours = update.initial_state(nets, config, sac.RULE, [3])
    ours.targets[...] += 0.01
    state = tree.tensors(ours)  # shares memory with ours
    rng = torch.Generator().manual_seed(0)

    def normal(*shape):
        return torch.randn(1, ROWS, *shape, generator=rng)

    terminal = (normal() > 1.5).float()
    ends = terminal, torch.zeros_like(terminal)  # the second is for costs, which SAC does not learn
    cost = normal().abs()[:, None]
    batch = Batch(normal(3), normal(2).tanh(), normal(), cost, normal(3), *ends)
    noise = update.UpdateNoise(normal(ACTION), normal(ACTION))
    settings = {"net_arch": list(HIDDEN), "activation_fn": nn.Tanh}
    how = {"learning_rate": RATE, "policy_kwargs": settings, "device": "cpu"}
    model = silent(sb3.SAC("MlpPolicy", Spaces(), **how))
    layers, last = linears(model.actor.latent_pi), (model.actor.mu, model.actor.log_std)
    put(state.actor[0], nets.actor, layers, last)
    for k in range(2):
        put(state.critics[0, k], nets.critic, linears(model.critic.q_networks[k]))
        put(state.targets[0, k], nets.critic, linears(model.critic_target.q_networks[k]))
    drawn = iter((noise.new_action[0], noise.next_action[0]))
    standard_normal = "torch.distributions.normal._standard_normal"
    monkeypatch.setattr(standard_normal, lambda *_, **__: next(drawn))
    columns = batch.observation, batch.action, batch.next_observation
    columns = [c[0] for c in columns] + [c[0, :, None] for c in (batch.terminal, batch.reward)]
    sample = sb3.common.type_aliases.ReplayBufferSamples(*columns)
    monkeypatch.setattr(model.replay_buffer, "sample", lambda *_, **__: sample)
    model.train(gradient_steps=1, batch_size=ROWS)

    outputs = nets.actor.forward(state.actor, batch.observation)
    entropy = -update.sampled(outputs.numpy(), noise.new_action.numpy()).log_prob.mean()
    batch = Batch(*(column.numpy() for column in batch))
    drawn = update.UpdateNoise(*(normals.numpy() for normals in noise[:2]))
    after, told = update.update(nets, config, sac.RULE, ours, batch, drawn)
    after = tree.tensors(after)
    assert told["entropy"].item() == pytest.approx(entropy, abs=1e-5)
    assert told["temperature"].item() == 1.0
    of_actor, of_critic = average(model.actor.optimizer), average(model.critic.optimizer)
    theirs = taken(nets.actor, layers, last)
    gradient = taken(nets.actor, layers, last, of_actor)
    assert_agree(after.actor[0], theirs, after.actor_moments.mean[0], gradient)
    for k in range(2):
        of_q = linears(model.critic.q_networks[k])
        gradients = after.critic_moments.mean[0, k], taken(nets.critic, of_q, of=of_critic)
        assert_agree(after.critics[0, k], taken(nets.critic, of_q), *gradients)
        target = taken(nets.critic, linears(model.critic_target.q_networks[k]))
        found = after.targets[0, k, : len(target)]
        torch.testing.assert_close(found, target, rtol=0, atol=0.005 * 2.1 * RATE + 1e-7)
    temperature = model.log_ent_coef.item()
    assert after.log_temperature[0, 0].item() == pytest.approx(temperature, abs=1e-8)


def episodes(rng):
    """Return a rollout of two episodes of 128 steps each, which end in a terminal state."""
    shape, ends = (ROWS // 2, 2), np.zeros((ROWS // 2, 2), bool)
    ends[-1] = True
    observation, following = rng.normal(size=(2, *shape, OBSERVATION)).astype(np.float32)
    following[:-1] = observation[1:]
    action = rng.normal(size=(*shape, ACTION)).astype(np.float32)
    reward, cost = rng.normal(size=shape), rng.random(size=(*shape, 1))
    ones, never = np.full(2, ROWS // 2), np.zeros_like(ends)
    columns = observation, action, reward, cost, following, ends, never
    return Rollout(*columns, ones, np.full(2, ""))


def test_an_update_of_ppo():
    """Three passes of one minibatch, so that the order of rows does not matter.

    Advantages are standardised beforehand, as we do; Stable-Baselines3 would standardise them in
    each minibatch, by the unbiased standard deviation.
    """
    config = ppo.ALGORITHM.config(
        episodes=2, batch_size=ROWS, hidden=HIDDEN, learning_rate=RATE, max_gradient_norm=1e9,
        actor_iterations=3, critic_iterations=3, clip_range=0.01,
    )  # fmt: skip
    it = learner("ppo", config, [5], OBSERVATION, ACTION)
    nets, state, rollout = it.nets, it._state, episodes(np.random.default_rng(0))
    settings = {"net_arch": {"pi": list(HIDDEN), "vf": list(HIDDEN)}}
    settings |= {"optimizer_kwargs": {"eps": 1e-8}}
    how = {"n_steps": ROWS, "batch_size": ROWS, "n_epochs": 3, "clip_range": 0.01, "device": "cpu"}
    how |= {"max_grad_norm": 1e9, "normalize_advantage": False, "policy_kwargs": settings}
    model = silent(sb3.PPO("MlpPolicy", Spaces(), learning_rate=RATE, **how))
    policy = model.policy
    actor = linears(policy.mlp_extractor.policy_net, policy.action_net)
    critic = linears(policy.mlp_extractor.value_net, policy.value_net)
    put(state.actor[0], nets.actor.net, actor)
    put(state.critics[0, 0], nets.critic, critic)
    buffer = model.rollout_buffer
    for step in range(ROWS):
        t, episode = step % (ROWS // 2), step // (ROWS // 2)
        observation = torch.from_numpy(rollout.observation[t, episode])[None]
        action = torch.from_numpy(rollout.action[t, episode])[None]
        with torch.no_grad():
            value, log_prob, _ = policy.evaluate_actions(observation, action)
        arrays = observation.numpy(), action.numpy(), rollout.reward[t, episode][None]
        buffer.add(*arrays, np.array([t == 0]), value, log_prob)
    buffer.compute_returns_and_advantage(torch.zeros(1), np.array([True]))
    buffer.advantages -= buffer.advantages.mean()
    buffer.advantages /= buffer.advantages.std()
    epoch = it._epoch(learned(rollout, config, it.costs), Packing(rollout.during, 1))
    np.testing.assert_allclose(epoch.reward_advantage[0, :ROWS], buffer.advantages[:, 0], 0, 2e-5)
    np.testing.assert_allclose(epoch.value_targets[0, 0, :ROWS], buffer.returns[:, 0], 0, 2e-5)
    model.train()

    metrics = it.learn(rollout, 0, np.ones(1, bool))[0]
    assert metrics[it.metrics.index("clipped")] > 0.1
    after, of = it._state, average(policy.optimizer)
    size, start = nets.actor.net.size, slice(nets.actor.net.size, nets.actor.net.size + ACTION)
    gradients = after.actor_moments.mean[0, :size], taken(nets.actor.net, actor, of=of)
    assert_agree(after.actor[0, :size], taken(nets.actor.net, actor), *gradients)
    gradients = after.critic_moments.mean[0, 0], taken(nets.critic, critic, of=of)
    assert_agree(after.critics[0, 0], taken(nets.critic, critic), *gradients)
    torch.testing.assert_close(after.actor[0, start], policy.log_std.data, rtol=0, atol=2e-6)
