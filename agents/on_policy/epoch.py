"""An epoch's environment steps: the episodes of each run laid end to end, and sums over them.

Runs with different numbers of steps share arrays; rows of weight 0 are padding.
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
"""Rows of a block: a multiple of 32 (see `descent`), enough for the paper's epoch of 500 steps."""


class EpochData(NamedTuple):
    """The environment steps of an epoch, run by run."""

    observation: Tensor
    """[R, B, critic inputs]: observations and what only critics see, see `critic_inputs`"""
    action: Tensor
    """[R, B, A]"""
    weight: Tensor
    """[R, B]: sums to 1"""
    reward_advantage: Tensor
    """[R, B], standardised"""
    cost_advantage: Tensor
    """[R, C, B], centred; with `standardize_cost_advantages` standardised"""
    value_targets: Tensor
    """[R, 1 + C, B]: for the reward and each cost"""
    length: Tensor
    """[R]: mean length of the episodes"""
    cost: Tensor
    """[R, C]: mean undiscounted costs of the episodes, J_C"""
    discounted_cost: Tensor | None = None
    """[R, C]: mean discounted costs of the episodes"""


class Packing:
    """Conversion between N = R·E episodes side by side and the steps of each run end to end."""

    def __init__(self, during: NDArray[np.bool_], runs: int) -> None:
        """during: [T, N], mask of the steps that belong to the episodes."""
        self._during = during.T
        self.steps = self._during.reshape(runs, -1).sum(axis=1)
        """Steps of each run, [R]."""
        self.size = max(1, -(-int(self.steps.max()) // BLOCK)) * BLOCK
        """Rows of each run, padding included."""
        self._run = np.repeat(np.arange(runs), self.steps)
        starts = np.cumsum(self.steps) - self.steps
        self._row = np.arange(len(self._run)) - starts[self._run]

    def pack(self, values: NDArray) -> NDArray[np.float32]:
        """Lay episodes end to end, [T, N, ...] -> [R, size, ...]; rows of padding are 0."""
        packed = np.zeros((len(self.steps), self.size, *values.shape[2:]), dtype=np.float32)
        packed[self._run, self._row] = values.swapaxes(0, 1)[self._during]
        return packed

    def unpack(self, packed: NDArray) -> NDArray[np.float64]:
        """Put episodes side by side, [R, size] -> [T, N]; 0 outside the episodes."""
        values = np.zeros(self._during.shape)
        values[self._during] = packed[self._run, self._row]
        return values.T

    @property
    def weight(self) -> NDArray[np.float32]:
        """[R, size]: `1 / steps` for a step, 0 for padding, so that weighted sums are means."""
        rows = np.arange(self.size) < self.steps[:, None]
        return (rows / np.maximum(self.steps, 1)[:, None]).astype(np.float32)


def total(values: Tensor) -> Tensor:
    """Sum over rows, [R, ..., B] -> [R, ...], block by block: the sum of a run is the same, bit for
    bit, whatever the padding that the other runs require."""
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
    """Return the advantages (GAE) of episodes side by side; all arrays are [T, N].

    `δ_t = r_t + γ V(s_{t+1}) (1 - terminal_t) - V(s_t)`, `A_t = δ_t + γλ A_{t+1}` within an
    episode; for costs as for rewards.
    next_value: of the observation that each step led to, also where a time limit then truncated the
    episode: such a step bootstraps, unless it counts as terminal.
    during: mask of the steps that belong to an episode; all other advantages are 0.
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
    """Environment steps of an epoch with the distribution of the policy that took them."""

    observation: Tensor
    """[R, B, critic inputs]"""
    action: Tensor
    """[R, B, A]"""
    weight: Tensor
    """[R, B]"""
    gains: Tensor
    """[R, 2, B]: advantages of the objective and the first cost"""
    old: Gaussian
    """The policy that took the steps."""
    old_log_prob: Tensor
    """[R, B]"""


def raised_advantage(
    rule: Any, config: Any, epoch: EpochData, steps: NDArray[np.int64], multipliers: Tensor
) -> Tensor:
    """Return the advantages [R, B] that a rule's `advantage` computes, 0 for rows of padding.

    It is called with the environment steps of one run at a time, so that it may take means over
    them. steps: [R]. Raises ValueError if it returns another shape.
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
    """Return the epoch's steps with the policy that took them; objective: advantages [R, B]."""
    old = nets.actor.distribution(actor, epoch.observation)
    gains = torch.cat((objective[:, None], epoch.cost_advantage[:, :1]), dim=1)
    of_policy = old, old.log_prob(epoch.action)
    return Taken(epoch.observation, epoch.action, epoch.weight, gains, *of_policy)


def compared(nets: Nets, actor: Tensor, steps: Taken) -> tuple[Tensor, Tensor]:
    """Compare a policy with the one that took the steps: `E[π(a|s) / π_old(a|s) · A]` for the
    objective and the first learned cost, [R, 2] ([R, 1] if none is learned), and the mean KL
    divergence from the old to the new one, [R]."""
    policy = nets.actor.distribution(actor, steps.observation)
    weighted = (steps.weight * ratios(policy, steps))[:, None] * steps.gains
    return total(weighted), _mean_kl(steps.old, policy, steps)


def ratios(policy: Gaussian, steps: Any) -> Tensor:
    """Return `π(a|s) / π_old(a|s)`, [R, B], and 1 in rows of weight 0, where a narrow policy may
    give ∞, and 0 · ∞ is NaN. steps: with action, old_log_prob and weight."""
    change = policy.log_prob(steps.action) - steps.old_log_prob
    return torch.where(steps.weight > 0, change, 0.0).exp()


def divergence(nets: Nets, actor: Tensor, steps: Taken, reverse: bool = False) -> Tensor:
    """Return the mean KL divergence from the old to the new policy, or the reverse, [R]."""
    policy = nets.actor.distribution(actor, steps.observation)
    pair = (policy, steps.old) if reverse else (steps.old, policy)
    return _mean_kl(*pair, steps)


def _mean_kl(of: Gaussian, to: Gaussian, steps: Taken) -> Tensor:
    return total(steps.weight * torch.where(steps.weight > 0, of.kl(to), 0.0))
