"""The yardstick: SAC-Lag for one run, as one writes it in plain PyTorch.

`nn.Module`s, `torch.optim.Adam`, a loop over one environment, the hyper-parameters of the paper.
It shares no code with `agents`; it is here to be timed beside it, and as a second implementation.
"""

import copy

import gymnasium as gym
import numpy as np
import torch
from torch import nn
from torch.nn import functional


def mlp(n_in, n_out):
    return nn.Sequential(
        nn.Linear(n_in, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, n_out)
    )


class Actor(nn.Module):
    def __init__(self):
        super().__init__()
        self.net = mlp(2, 4)

    def forward(self, observation):
        mean, log_std = self.net(observation).chunk(2, dim=-1)
        normal = torch.distributions.Normal(mean, log_std.clamp(-20, 2).exp())
        u = normal.rsample()
        correction = 2 * (np.log(2.0) - u - functional.softplus(-2 * u))
        return torch.tanh(u), (normal.log_prob(u) - correction).sum(dim=-1)


class Critic(nn.Module):
    def __init__(self):
        super().__init__()
        self.first, self.second = mlp(4, 1), mlp(4, 1)

    def forward(self, observation, action):
        x = torch.cat([observation, action], dim=-1)
        return self.first(x).squeeze(-1), self.second(x).squeeze(-1)


class PlainSACLag:
    cost_limit, discount, tau, capacity = 5.0, 0.99, 0.005, 50_000

    def __init__(self, seed):
        torch.manual_seed(seed)
        self.rng = np.random.default_rng(seed)
        self.actor, self.critic, self.cost_critic = Actor(), Critic(), Critic()
        self.critic_target = copy.deepcopy(self.critic)
        self.cost_target = copy.deepcopy(self.cost_critic)
        self.log_alpha = torch.zeros((), requires_grad=True)
        self.raw_beta = torch.zeros((), requires_grad=True)
        self.optimizers = [
            torch.optim.Adam(parameters, lr=3e-4)
            for parameters in (
                [*self.critic.parameters(), *self.cost_critic.parameters()],
                self.actor.parameters(),
                [self.log_alpha],
                [self.raw_beta],
            )
        ]
        self.replay = np.zeros((self.capacity, 9), dtype=np.float32)
        self.stored = 0

    def act(self, observation):
        with torch.no_grad():
            return self.actor(torch.as_tensor(observation)[None])[0][0].numpy()

    def store(self, *transition):
        self.replay[self.stored % self.capacity] = np.concatenate(
            [np.atleast_1d(value) for value in transition]
        )
        self.stored += 1

    def minimize(self, optimizer, loss):
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()

    def update(self):
        index = self.rng.integers(min(self.stored, self.capacity), size=256)
        batch = torch.as_tensor(self.replay[index])
        obs, action, reward, cost, obs2, end = batch.split([2, 2, 1, 1, 2, 1], dim=-1)
        reward, cost, going_on = reward[:, 0], cost[:, 0], 1 - end[:, 0]
        for_critics, for_actor, for_alpha, for_beta = self.optimizers
        alpha = self.log_alpha.exp().detach()
        with torch.no_grad():
            action2, log_prob2 = self.actor(obs2)
            value = torch.minimum(*self.critic_target(obs2, action2)) - alpha * log_prob2
            cost_value = torch.maximum(*self.cost_target(obs2, action2))
            target = reward + self.discount * going_on * value
            cost_target = cost + self.discount * going_on * cost_value
        loss = 0.5 * sum(functional.mse_loss(q, target) for q in self.critic(obs, action))
        loss += 0.5 * sum(
            functional.mse_loss(q, cost_target) for q in self.cost_critic(obs, action)
        )
        self.minimize(for_critics, loss)

        for critic in (self.critic, self.cost_critic):
            critic.requires_grad_(False)
        new_action, log_prob = self.actor(obs)
        risk = torch.maximum(*self.cost_critic(obs, new_action))
        q = torch.minimum(*self.critic(obs, new_action))
        beta = functional.softplus(self.raw_beta).detach()
        self.minimize(for_actor, (alpha * log_prob - q + beta * risk).mean())
        for critic in (self.critic, self.cost_critic):
            critic.requires_grad_(True)

        self.minimize(for_alpha, -(self.log_alpha.exp() * (log_prob.detach() - 2)).mean())
        excess = (risk.detach() - self.cost_limit).mean()
        self.minimize(for_beta, -functional.softplus(self.raw_beta) * excess)
        with torch.no_grad():
            for net, slow in (
                (self.critic, self.critic_target),
                (self.cost_critic, self.cost_target),
            ):
                for p, p_slow in zip(net.parameters(), slow.parameters(), strict=True):
                    p_slow.lerp_(p, self.tau)


def train(seed, steps, task="Circle2D-1-v0", random_steps=5_000):
    """Train for `steps` environment steps; returns the returns and cost returns of the episodes."""
    env, agent = gym.make(task), PlainSACLag(seed)
    env.action_space.seed(seed)
    returns, costs = [], []
    observation, _ = env.reset(seed=seed)
    episode_return = episode_cost = 0.0
    for step in range(steps):
        explore = step < random_steps
        action = env.action_space.sample() if explore else agent.act(observation)
        observation2, reward, terminated, truncated, info = env.step(action)
        # The paper preset: step 50 is terminal.
        end = terminated or truncated
        agent.store(observation, action, reward, info["cost"], observation2, end)
        episode_return += reward
        episode_cost += info["cost"]
        observation = observation2
        if end:
            returns.append(episode_return)
            costs.append(episode_cost)
            episode_return = episode_cost = 0.0
            observation, _ = env.reset()
            if agent.stored >= 256:
                for _ in range(5):
                    agent.update()
    return returns, costs
