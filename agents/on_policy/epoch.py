"""Episodes of each run laid end to end, and sums over them.

Runs whose episodes have different lengths share arrays; rows of weight 0 fill the rest.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from agents.on_policy.state import Gaussian, Nets

BLOCK = 512
"""Rows of a block: a multiple of 32 (see `descent`) that holds the paper's epoch of 500 steps."""


class EpochData(NamedTuple):
    """The steps of an epoch, run by run."""

    observation: Tensor
    """[R, B, critic inputs]: with what the critics alone see, see `critic_inputs`"""
    action: Tensor
    """[R, B, A]"""
    weight: Tensor
    """[R, B]: adds up to 1"""
    reward_advantage: Tensor
    """[R, B], standardised"""
    cost_advantage: Tensor
    """[R, C, B], centred; with `standardize_cost_advantages` standardised"""
    value_targets: Tensor
    """[R, 1 + C, B]: of the reward, of each cost"""
    length: Tensor
    """[R]: mean length of the episodes"""
    cost: Tensor
    """[R, C]: mean undiscounted costs of the episodes, J_C"""
    discounted_cost: Tensor | None = None
    """[R, C]: mean discounted costs of the episodes"""


class Packing:
    """Where the steps of N = R·E episodes side by side lie, run by run."""

    def __init__(self, during: NDArray[np.bool_], runs: int) -> None:
        """during: [T, N], which steps belong to the episodes."""
        self._during = during.T
        self.steps = self._during.reshape(runs, -1).sum(axis=1)
        """Steps of each run, [R]."""
        self.size = max(1, -(-int(self.steps.max()) // BLOCK)) * BLOCK
        """Rows of each run, padding included."""
        self._run = np.repeat(np.arange(runs), self.steps)
        starts = np.cumsum(self.steps) - self.steps
        self._row = np.arange(len(self._run)) - starts[self._run]

    def pack(self, values: NDArray) -> NDArray[np.float32]:
        """[T, N, ...] -> [R, size, ...]; rows beyond a run's steps are 0."""
        packed = np.zeros((len(self.steps), self.size, *values.shape[2:]), dtype=np.float32)
        packed[self._run, self._row] = values.swapaxes(0, 1)[self._during]
        return packed

    def unpack(self, packed: NDArray) -> NDArray[np.float64]:
        """[R, size] -> [T, N]; 0 outside the episodes."""
        values = np.zeros(self._during.shape)
        values[self._during] = packed[self._run, self._row]
        return values.T

    @property
    def weight(self) -> NDArray[np.float32]:
        """[R, size]: `1 / steps` in a run's own rows, so that sums of weighted rows are means."""
        rows = np.arange(self.size) < self.steps[:, None]
        return (rows / np.maximum(self.steps, 1)[:, None]).astype(np.float32)


def total(values: Tensor) -> Tensor:
    """Sums over rows [R, ..., B] -> [R, ...], of one block after another: a run's is the same, bit
    for bit, however many rows the others have."""
    parts = values.unflatten(-1, (-1, BLOCK)).sum(dim=-1)
    return functools.reduce(torch.add, parts.unbind(dim=-1))


def advantages(
    reward: NDArray[np.floating],
    value: NDArray[np.floating],
    next_value: NDArray[np.floating],
    terminal: NDArray[np.bool_],
    during: NDArray[np.bool_],
    discount: float,
    gae_lambda: float,
) -> NDArray[np.float64]:
    """Advantages of episodes side by side; everything is [T, N].

    `δ_t = r_t + γ V(s_{t+1}) (1 - terminal_t) - V(s_t)`, `A_t = δ_t + γλ A_{t+1}` within an
    episode. next_value: of the observation each step led to, also where a time limit then cut the
    episode off: such a step is not terminal and bootstraps. during: the steps that belong to an
    episode; the others get 0. Works for costs as for rewards.
    Source: Schulman et al. 2016 ("High-dimensional continuous control using GAE"), equation 16.
    """
    delta = reward + discount * np.where(terminal, 0.0, next_value) - value
    result = np.zeros(reward.shape)
    following = np.zeros(reward.shape[1])
    for t in reversed(range(len(reward))):
        following = np.where(during[t], delta[t] + discount * gae_lambda * following, 0.0)
        result[t] = following
    return result


class Taken(NamedTuple):
    """Steps of an epoch, with the distribution of the policy that took them."""

    observation: Tensor
    """[R, B, critic inputs]"""
    action: Tensor
    """[R, B, A]"""
    weight: Tensor
    """[R, B]"""
    gains: Tensor
    """[R, 2, B]: advantages of the objective and of the first cost"""
    old: Gaussian
    """The policy before its step."""
    old_log_prob: Tensor
    """[R, B]"""


def raised_advantage(
    rule: Any, config: Any, epoch: EpochData, steps: NDArray[np.int64], multipliers: Tensor
) -> Tensor:
    """The advantages [R, B] that a rule has the policy raise, 0 behind the steps [R] of each run.

    Each run's are of its own steps alone, so that a rule may take their mean. Raises ValueError
    where they have another shape.
    """
    raised = torch.zeros_like(epoch.reward_advantage)
    for run, n in enumerate(steps.tolist()):
        if n:
            own = slice(run, run + 1)
            reward, cost = epoch.reward_advantage[own, :n], epoch.cost_advantage[own, :, :n]
            gains = rule.advantage(config, reward, cost, multipliers[own])
            if gains.shape != reward.shape:
                shapes = f"{list(reward.shape)}, got {list(gains.shape)}"
                raise ValueError(f"advantage must be [runs, steps], here {shapes}")
            raised[run, :n] = gains[0]
    return raised


def taken(nets: Nets, actor: Tensor, epoch: EpochData, objective: Tensor) -> Taken:
    """The epoch's steps under the policy that took them; objective: advantages [R, B]."""
    old = nets.actor.distribution(actor, epoch.observation)
    gains = torch.stack((objective, epoch.cost_advantage[:, 0]), dim=1)
    of_policy = old, old.log_prob(epoch.action)
    return Taken(epoch.observation, epoch.action, epoch.weight, gains, *of_policy)


def compared(nets: Nets, actor: Tensor, steps: Taken) -> tuple[Tensor, Tensor]:
    """A policy against the one before: `E[π(a|s) / π_old(a|s) · A]` for the objective and the first
    cost, [R, 2], and the mean KL divergence from the old to the new one, [R]."""
    policy = nets.actor.distribution(actor, steps.observation)
    held = steps.weight > 0  # elsewhere a sharp policy may give infinity, and 0 · ∞ is NaN
    change = torch.where(held, policy.log_prob(steps.action) - steps.old_log_prob, 0.0)
    weighted = (steps.weight * change.exp())[:, None] * steps.gains
    kl = torch.where(held, steps.old.kl(policy), 0.0)
    return total(weighted), total(steps.weight * kl)


def divergence(nets: Nets, actor: Tensor, steps: Taken, reverse: bool = False) -> Tensor:
    """The mean KL divergence from the old policy to another, or the other way round, [R]."""
    policy = nets.actor.distribution(actor, steps.observation)
    kl = policy.kl(steps.old) if reverse else steps.old.kl(policy)
    return total(steps.weight * torch.where(steps.weight > 0, kl, 0.0))
