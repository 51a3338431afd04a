"""Reference for the SAC family: SAC-Lag, SAC-LB and WCSAC for one run, in plain PyTorch.

`nn.Module`s, `torch.optim.Adam`, a loop over one environment, the hyper-parameters of the paper.
It shares no code with `agents`: it is a baseline for timings and an independent implementation.
"""

import copy
import math

import gymnasium as gym
import numpy as np
import torch
from torch import nn
from torch.distributions import Normal
from torch.nn import functional

import circle2d_mj  # noqa: F401 - registers the tasks


def mlp(n_in, n_out):
    return nn.Sequential(
        nn.Linear(n_in, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, n_out)
    )


class Actor(nn.Module):
    def __init__(self):
        super().__init__()
        self.net = mlp(2, 4)

    def normal(self, observation):
        mean, log_std = self.net(observation).chunk(2, dim=-1)
        return Normal(mean, log_std.clamp(-20, 2).exp(), validate_args=False)

    def forward(self, observation):
        """Sample actions; return them and their log-probabilities."""
        normal = self.normal(observation)
        u = normal.rsample()
        correction = 2 * (math.log(2.0) - u - functional.softplus(-2 * u))
        return torch.tanh(u), (normal.log_prob(u) - correction).sum(dim=-1)

    @torch.no_grad()
    def act(self, observation):
        return torch.tanh(self.normal(torch.as_tensor(observation)).sample()).numpy()


class Critic(nn.Module):
    def __init__(self):
        super().__init__()
        self.first, self.second = mlp(4, 1), mlp(4, 1)

    def forward(self, observation, action):
        x = torch.cat([observation, action], dim=-1)
        return self.first(x).squeeze(-1), self.second(x).squeeze(-1)


class SACLag:
    """SAC with two cost critics, and a multiplier for the larger of their outputs."""

    cost_limit, discount, tau, capacity = 5.0, 0.99, 0.005, 50_000
    has_multiplier = True

    def __init__(self, seed):
        torch.manual_seed(seed)
        self.rng = np.random.default_rng(seed)
        self.actor, self.critic, self.cost_critic = Actor(), Critic(), Critic()
        self.critic_target = copy.deepcopy(self.critic)
        self.cost_target = copy.deepcopy(self.cost_critic)
        self.log_alpha = torch.zeros((), requires_grad=True)
        self.raw_multiplier = torch.zeros((), requires_grad=True)
        self.for_actor = torch.optim.Adam(self.actor.parameters(), lr=3e-4)
        fast = [*self.critic.parameters(), *self.cost_critic.parameters()]
        slow = [*self.critic_target.parameters(), *self.cost_target.parameters()]
        self.slow_and_fast = list(zip(slow, fast, strict=True))
        self.for_critics = torch.optim.Adam(fast, lr=3e-4)
        self.for_alpha = torch.optim.Adam([self.log_alpha], lr=3e-4)
        self.for_multiplier = torch.optim.Adam([self.raw_multiplier], lr=3e-4)
        self.replay = np.zeros((self.capacity, 9), dtype=np.float32)
        self.stored = 0

    def multiplier(self):
        return functional.softplus(self.raw_multiplier)

    def risk(self, costs):
        """Return the cost estimate that the actor penalises, from both cost critics' outputs."""
        return torch.maximum(*costs)

    def cost_loss(self, costs, next_costs, cost, discount):
        target = cost + discount * torch.maximum(*next_costs)
        return 0.5 * sum(functional.mse_loss(q, target) for q in costs)

    def penalty(self, risk):
        return self.multiplier().detach() * risk

    def store(self, observation, action, reward, cost, observation2, end):
        row = (*observation, *action, reward, cost, *observation2, end)
        self.replay[self.stored % self.capacity] = row
        self.stored += 1

    def update(self):
        index = self.rng.integers(min(self.stored, self.capacity), size=256)
        self.learn(torch.as_tensor(self.replay[index]))

    def learn(self, batch):
        """Take a gradient step for all networks and multipliers; batch: rows as in `store`.

        Returns the losses of the critics and of the actor."""
        obs, action, reward, cost, obs2, end = batch.split([2, 2, 1, 1, 2, 1], dim=-1)
        reward, cost = reward[:, 0], cost[:, 0]
        discount = self.discount * (1 - end[:, 0])
        alpha = self.log_alpha.exp().detach()
        with torch.no_grad():
            action2, log_prob2 = self.actor(obs2)
            value = torch.minimum(*self.critic_target(obs2, action2)) - alpha * log_prob2
            target = reward + discount * value
            next_costs = self.cost_target(obs2, action2)
        critic_loss = 0.5 * sum(functional.mse_loss(q, target) for q in self.critic(obs, action))
        costs = self.cost_critic(obs, action)
        critic_loss = critic_loss + self.cost_loss(costs, next_costs, cost, discount)
        minimize(self.for_critics, critic_loss)

        new_action, log_prob = self.actor(obs)
        risk = self.risk(self.cost_critic(obs, new_action))
        q = torch.minimum(*self.critic(obs, new_action))
        actor_loss = (alpha * log_prob - q + self.penalty(risk)).mean()
        minimize(self.for_actor, actor_loss)
        minimize(self.for_alpha, -self.log_alpha.exp() * (log_prob.detach().mean() - 2))
        if self.has_multiplier:
            excess = risk.detach().mean() - self.cost_limit
            minimize(self.for_multiplier, -self.multiplier() * excess)
        with torch.no_grad():
            for slow, parameter in self.slow_and_fast:
                slow.lerp_(parameter, self.tau)
        return critic_loss.detach(), actor_loss.detach()


class SACLB(SACLag):
    """SAC with a smoothed log barrier instead of the multiplier."""

    factor, has_multiplier = 3.0, False

    def penalty(self, risk):
        z, t = risk - self.cost_limit, self.factor
        switch = -1 / t**2
        barrier = -torch.log(-z.clamp(max=switch)) / t
        tangent = t * z - math.log(1 / t**2) / t + 1 / t
        return torch.where(z <= switch, barrier, tangent)


class WCSAC(SACLag):
    """SAC whose cost critics predict mean and variance of the cost, and whose actor penalises the
    CVaR."""

    level, damping = 0.5, 10.0

    def __init__(self, seed):
        super().__init__(seed)
        normal = Normal(0.0, 1.0)
        quantile = normal.icdf(torch.tensor(self.level, dtype=torch.float64))
        self.deviations = normal.log_prob(quantile).exp().item() / self.level

    def multiplier(self):
        return self.raw_multiplier.exp()

    def variance(self, output):
        return functional.softplus(output).clamp(1e-8, 1e8)

    def risk(self, costs):
        return costs[0] + self.deviations * self.variance(costs[1]).sqrt()

    def cost_loss(self, costs, next_costs, cost, discount):
        q, v = costs[0], self.variance(costs[1])
        q2, v2 = next_costs[0], self.variance(next_costs[1])
        v_target = cost**2 - q.detach() ** 2 + 2 * discount * cost * q2 + discount**2 * (v2 + q2**2)
        v_target = v_target.clamp(1e-8, 1e8)
        wasserstein = (v + v_target - 2 * (v * v_target).sqrt()).mean()
        return 0.5 * functional.mse_loss(q, cost + discount * q2) + 0.5 * wasserstein

    def penalty(self, risk):
        damp = self.damping * (self.cost_limit - risk.detach().mean())
        return (self.multiplier().detach() - damp) * risk


def minimize(optimizer, loss):
    """Take a step of an optimizer; gradients are computed only for the optimizer's parameters."""
    optimizer.zero_grad()
    loss.backward(inputs=optimizer.param_groups[0]["params"])
    optimizer.step()


AGENTS = {"sac-lag": SACLag, "sac-lb": SACLB, "wcsac": WCSAC}


def epochs(seed, algorithm="sac-lag", task="Circle2D-1-v0", random_steps=5_000, gradient_steps=5):
    """Train without end; yield steps, return and cost after every epoch, which is an episode."""
    env, agent = gym.make(task), AGENTS[algorithm](seed)
    env.action_space.seed(seed)
    observation, _ = env.reset(seed=seed)
    step, episode_return, episode_cost = 0, 0.0, 0.0
    while True:
        explore = step < random_steps
        action = env.action_space.sample() if explore else agent.actor.act(observation)
        observation2, reward, terminated, truncated, info = env.step(action)
        # The paper preset: step 50 is terminal.
        end = terminated or truncated
        agent.store(observation, action, reward, info["cost"], observation2, end)
        step += 1
        episode_return += reward
        episode_cost += info["cost"]
        observation = observation2
        if end:
            if agent.stored >= 256:
                for _ in range(gradient_steps):
                    agent.update()
            yield step, [episode_return], [episode_cost]
            episode_return = episode_cost = 0.0
            observation, _ = env.reset()
