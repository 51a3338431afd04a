"""REINFORCE-State: a complete Learner, REINFORCE with a multiplier that depends on the state.

The mean of a Gaussian policy and the argument of the multiplier `λ(s) = softplus(w·s + b)` are
linear in the state. The policy ascends `E[Σ r - λ(s) c]`, the multiplier `E[λ(s) (J_C - d)]`: λ
rises in states that episodes above the limit visit.
"""

from dataclasses import dataclass
from functools import partial
from typing import Annotated

import numpy as np
import torch

import agents
from agents.checks import In, Settings
from agents.lockstep.noise import Purpose, normal, steps_of_noise, streams


@dataclass(frozen=True)
class ReinforceConfig(Settings):
    """Hyper-parameters of REINFORCE-State."""

    episodes: Annotated[int, In(2)] = 10
    """Complete episodes per epoch."""
    learning_rate: Annotated[float, In(above=0)] = 0.02
    """Step size of the policy."""
    multiplier_lr: Annotated[float, In(0)] = 0.01
    """Step size of the multiplier."""
    std: Annotated[float, In(above=0)] = 0.5
    """Standard deviation of actions in [-1, 1]."""
    cost_limit: Annotated[float, In(0)] = 25.0
    """Limit d of the cost of an episode, J_C."""


def with_one(observation):
    """Append a 1 to observations [..., size], for the constant term of linear functions."""
    return np.concatenate([observation, np.ones((*observation.shape[:-1], 1))], axis=-1)


def act(weights, std, observation, noise):
    """Return actions [R, N, A] for weights [R, size + 1, A] and observations [R, N, size]."""
    mean = with_one(observation) @ weights
    return (mean if noise is None else mean + std * noise).astype(np.float32)


def to_go(values):
    """Return sums over the rest of each episode, [T, E]."""
    return np.cumsum(values[::-1], axis=0)[::-1]


class Reinforce:
    """R runs side by side. Each is computed separately, so that none depends on the others."""

    metrics = ("multiplier",)

    def __init__(self, config, rule, seeds, observation_size, action_size):
        self.config, self.seeds, self.episodes = config, tuple(seeds), config.episodes
        size, rngs = (observation_size + 1, action_size), streams(seeds, Purpose.PARAMETERS, 0)
        self.weights = np.stack([0.1 * rng.normal(size=size) for rng in rngs])
        self.multiplier = np.zeros((len(seeds), observation_size + 1))

    def policy(self):
        """Return a function of observations and noise; it can be pickled and never changes."""
        return partial(act, self.weights.copy(), self.config.std)

    def module(self, run):
        """Return the module for `to_torch` and `export`; it must act as `policy` without noise."""
        weights = torch.tensor(self.weights[run], dtype=torch.float32)
        layer = torch.nn.Linear(*weights[:-1].shape)
        layer.load_state_dict({"weight": weights[:-1].T, "bias": weights[-1]})
        return layer

    def explorer(self, epoch, steps):
        """Return the behaviour policy. Its noise depends only on seed and epoch, so that a training
        continues bit for bit after an interruption."""
        policy, shape = self.policy(), (self.episodes, self.weights.shape[-1])
        noise = steps_of_noise(normal, self.seeds, Purpose.EXPLORATION, epoch, shape)

        def explore(observation):  # [R · E, size]
            apart = observation.reshape(len(self.seeds), self.episodes, -1)
            return policy(apart, next(noise)).reshape(len(observation), -1)

        return explore

    def learn(self, rollout, epoch, active):
        """Update the active runs; return `metrics`, [R, 1], NaN for runs that failed or ended."""
        metrics = np.full((len(self.seeds), len(self.metrics)), np.nan)
        for run in np.flatnonzero(active):
            own = rollout.of(slice(run * self.episodes, (run + 1) * self.episodes))
            metrics[run] = self._learn(run, own)
        return metrics

    def _learn(self, run, own):
        """Learn from a run's E episodes, [T, E, ...]; `during` masks the steps that exist."""
        config, state, during = self.config, with_one(own.observation), own.during
        before = state @ self.multiplier[run]
        multiplier = np.logaddexp(0.0, before)
        gain = to_go(own.reward * during) - multiplier * to_go(own.cost[..., 0] * during)
        count = during.sum(axis=1, keepdims=True)
        gain = gain - (gain * during).sum(axis=1, keepdims=True) / np.maximum(count, 1)
        gain = gain / (gain[during].std() + 1e-8)
        noise = (own.action - state @ self.weights[run]) / config.std
        slope = np.einsum("te,tes,tea->sa", gain * during, state, noise) / during.sum()
        self.weights[run] += config.learning_rate * slope
        excess = own.cost_returns[:, 0] - config.cost_limit
        share = during / (1.0 + np.exp(-before))  # the slope of softplus
        slope = np.einsum("te,e,tes->s", share, excess, state) / during.sum()
        self.multiplier[run] += config.multiplier_lr * slope
        return multiplier[during].mean()

    def finite(self):
        return np.isfinite(self.weights).all(axis=(1, 2)) & np.isfinite(self.multiplier).all(axis=1)

    def state_dict(self):
        """Return all state needed to resume a training; a policy is loaded from `actor` alone."""
        return {"actor": self.weights.copy(), "multiplier": self.multiplier.copy()}

    def load_state_dict(self, state):
        for name, array in (("actor", self.weights), ("multiplier", self.multiplier)):
            if state[name].shape != array.shape:
                raise ValueError(f"{name} must be {array.shape}, got {state[name].shape}")
            array[:] = state[name]


algorithm = agents.Algorithm("REINFORCE-State", ReinforceConfig, None, Reinforce)
agents.register("reinforce-state", algorithm)
