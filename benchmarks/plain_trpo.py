"""Reference for the on-policy family: TRPO-Lag and CPO for one run, in plain PyTorch.

`nn.Module`s, `torch.optim.Adam`, Fisher-vector products by differentiating twice, a loop over one
environment, the hyper-parameters of the paper. It shares no code with `agents`: it is a baseline
for timings and an independent implementation.
"""

import math

import gymnasium as gym
import numpy as np
import torch
from torch import nn
from torch.distributions import Normal, kl_divergence
from torch.nn import functional
from torch.nn.utils import parameters_to_vector, vector_to_parameters

import circle2d_mj  # noqa: F401 - registers the tasks


def mlp(n_in, n_out):
    return nn.Sequential(
        nn.Linear(n_in, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, n_out)
    )


class Actor(nn.Module):
    def __init__(self):
        super().__init__()
        self.net = mlp(2, 2)
        self.log_std = nn.Parameter(torch.zeros(2))

    def forward(self, observation):
        return Normal(self.net(observation), self.log_std.exp(), validate_args=False)

    @torch.no_grad()
    def act(self, observation):
        return self(torch.as_tensor(observation)).sample().numpy()


def advantages(rewards, values, discount=0.99, gae_lambda=0.95):
    """Return the GAE advantages of one episode, truncated by its time limit, [T]; rewards: [T];
    values: [T + 1], the last one of the final observation."""
    deltas = rewards + discount * values[1:] - values[:-1]
    found, following = np.zeros_like(deltas), 0.0
    for t in reversed(range(len(deltas))):
        found[t] = following = deltas[t] + discount * gae_lambda * following
    return found


def conjugate_gradient(product, b, iterations=15):
    x, residual, direction = torch.zeros_like(b), b.clone(), b.clone()
    start = square = residual @ residual
    for _ in range(iterations):
        if square <= 1e-10 * start:
            break
        image = product(direction)
        step = square / (direction @ image)
        x += step * direction
        residual -= step * image
        before, square = square, residual @ residual
        direction = residual + square / before * direction
    return x


class TRPOLag:
    """TRPO on `(A_r - λ A_c) / (1 + λ)`; λ rises with the cost of the episodes."""

    cost_limit, target_kl, damping = 5.0, 0.01, 0.1
    has_multiplier = True

    def __init__(self, seed):
        torch.manual_seed(seed)
        self.rng = np.random.default_rng(seed)
        self.actor, self.value, self.cost_value = Actor(), mlp(2, 1), mlp(2, 1)
        self.critics = nn.ModuleList([self.value, self.cost_value])
        self.for_critics = torch.optim.Adam(self.critics.parameters(), lr=3e-4)
        self.multiplier = torch.tensor(0.001, requires_grad=True)
        self.for_multiplier = torch.optim.Adam([self.multiplier], lr=0.005)

    def objective(self, reward_advantage, cost_advantage):
        multiplier = self.multiplier.item()
        return (reward_advantage - multiplier * cost_advantage) / (1 + multiplier)

    def learn(self, episodes):
        """Update from an epoch; episodes: (observations with the final one, actions, rewards,
        costs)."""
        everything = torch.as_tensor(np.concatenate([episode[0] for episode in episodes]))
        with torch.no_grad():
            both = [critic(everything)[:, 0].double().numpy() for critic in self.critics]
        columns, start = [], 0
        for observations, actions, rewards, costs in episodes:
            end = start + len(observations)
            value, cost_value = both[0][start:end], both[1][start:end]
            gains, losses = advantages(rewards, value), advantages(costs, cost_value)
            values = value[:-1], cost_value[:-1]
            columns.append((observations[:-1], actions, gains, losses, *values))
            start = end
        columns = [np.concatenate(column) for column in zip(*columns, strict=True)]
        obs, action, gain, cost_gain, value, cost_value = (
            torch.as_tensor(column, dtype=torch.float32) for column in columns
        )
        targets = gain + value, cost_gain + cost_value
        gain = (gain - gain.mean()) / (gain.std(correction=0) + 1e-8)
        cost_gain = cost_gain - cost_gain.mean()
        excess = float(np.mean([costs.sum() for *_, costs in episodes])) - self.cost_limit
        self.policy_step(obs, action, gain, cost_gain, excess, len(obs) / len(episodes))
        self.fit_critics(obs, *targets)
        self.multiplier_step(excess)

    def policy_step(self, obs, action, gain, cost_gain, excess, length):
        """Update the actor. gain, cost_gain: advantages, the first standardised, the second
        centred; excess: mean cost of an episode minus the limit; length: mean episode length."""
        objective, parameters = self.objective(gain, cost_gain), list(self.actor.parameters())
        with torch.no_grad():
            old = self.actor(obs)
            old_log_prob = old.log_prob(action).sum(dim=-1)

        def surrogates(policy):
            ratio = (policy.log_prob(action).sum(dim=-1) - old_log_prob).exp()
            return (ratio * objective).mean(), (ratio * cost_gain).mean() * length

        def flat_gradient(of, **kwargs):
            return torch.cat([g.flatten() for g in torch.autograd.grad(of, parameters, **kwargs)])

        policy = self.actor(obs)
        before = surrogates(policy)
        gradient = flat_gradient(before[0], retain_graph=True)
        kl = kl_divergence(old, policy).sum(dim=-1).mean()
        kl_gradient = flat_gradient(kl, create_graph=True)

        def product(v):
            return flat_gradient(kl_gradient @ v, retain_graph=True) + self.damping * v

        def cost_gradient():
            return flat_gradient(before[1], retain_graph=True)

        step, must_improve, bound = self.step(gradient, cost_gradient, excess, product)
        start = parameters_to_vector(parameters).detach()
        with torch.no_grad():
            for k in range(15):
                vector_to_parameters(start + 0.8**k * step, parameters)
                policy = self.actor(obs)
                after = surrogates(policy)
                allowed = kl_divergence(old, policy).sum(dim=-1).mean() <= self.target_kl
                allowed = allowed and (after[0] > before[0] or not must_improve)
                if allowed and after[1] - before[1] <= bound:
                    return
            vector_to_parameters(start, parameters)

    def step(self, gradient, cost_gradient, excess, product):
        """Return the step, whether it must improve the objective, and how much cost it may add."""
        return self.to_boundary(conjugate_gradient(product, gradient), product), True, math.inf

    def to_boundary(self, direction, product):
        square = direction @ product(direction)
        if square <= 0:
            return torch.zeros_like(direction)
        return direction * (2 * self.target_kl / square).sqrt()

    def fit_critics(self, obs, target, cost_target):
        for _ in range(10):
            order = torch.as_tensor(self.rng.permutation(len(obs)))
            for index in order.split(256):
                x = obs[index]
                loss = functional.mse_loss(self.value(x)[:, 0], target[index])
                loss = loss + functional.mse_loss(self.cost_value(x)[:, 0], cost_target[index])
                minimize(self.for_critics, 0.5 * loss)

    def multiplier_step(self, excess):
        if self.has_multiplier:
            minimize(self.for_multiplier, -self.multiplier * excess)
            self.multiplier.data.clamp_(min=0)


class CPO(TRPOLag):
    """TRPO with the cost constraint in the step: maximise g·x with `c + b·x ≤ 0`, `½ xᵀHx ≤ δ`."""

    has_multiplier = False

    def objective(self, reward_advantage, cost_advantage):
        return reward_advantage

    def step(self, gradient, cost_gradient, excess, product):
        b, c, delta = cost_gradient(), excess, self.target_kl
        to_g, to_b = conjugate_gradient(product, gradient), conjugate_gradient(product, b)
        q, r, s = ((x @ y).item() for x, y in ((gradient, to_g), (gradient, to_b), (b, to_b)))
        bound = max(0.0, -c)
        outside = s >= 1e-8 and c**2 / s > 2 * delta
        if s < 1e-8 or (outside and c <= 0):  # no b, or the whole trust region is feasible
            return self.to_boundary(to_g, product), c <= 0, bound
        if outside:  # the whole trust region is infeasible: lower the cost
            return self.to_boundary(-to_b, product), False, bound
        free = to_g * math.sqrt(2 * delta / q) if q > 0 else to_g
        if c + (b @ free).item() <= 0:
            return free, c <= 0, bound
        # The constraint is active: go to the nearest point of its hyperplane, then along the
        # hyperplane to the boundary of the trust region.
        along, room = q - r**2 / s, 2 * delta - c**2 / s
        onwards = (to_g - r / s * to_b) * math.sqrt(room / along) if along > 1e-6 * q else 0.0
        return onwards - c / s * to_b, c <= 0, bound


def minimize(optimizer, loss):
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()


AGENTS = {"trpo-lag": TRPOLag, "cpo": CPO}


def epochs(seed, algorithm="trpo-lag", task="Circle2D-1-v0"):
    """Train without end; yield steps, returns and costs after every epoch of 10 episodes."""
    env, agent = gym.make(task), AGENTS[algorithm](seed)
    env.reset(seed=seed)
    step = 0
    while True:
        episodes = [episode(env, agent.actor) for _ in range(10)]
        agent.learn(episodes)
        step += sum(len(rewards) for _, _, rewards, _ in episodes)
        yield step, [e[2].sum() for e in episodes], [e[3].sum() for e in episodes]


def episode(env, actor):
    observation, _ = env.reset()
    observations, actions, rewards, costs, end = [observation], [], [], [], False
    while not end:
        action = actor.act(observation)
        observation, reward, terminated, truncated, info = env.step(action)
        end = terminated or truncated
        observations.append(observation)
        actions.append(action)
        rewards.append(reward)
        costs.append(info["cost"])
    return np.array(observations), np.array(actions), np.array(rewards), np.array(costs)
