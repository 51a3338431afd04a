"""The replay of all runs: a ring of transitions for each."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from agents.lockstep import tree
from agents.lockstep.backend import tensor
from agents.lockstep.rollout import Rollout


class Batch(NamedTuple):
    """Transitions drawn from the replay."""

    observation: Tensor
    """[R, B, critic inputs]: with what the critics alone see, see `critic_inputs`"""
    action: Tensor
    """[R, B, action size], in [-1, 1]"""
    reward: Tensor
    """[R, B]"""
    cost: Tensor
    """[R, C, B]"""
    next_observation: Tensor
    """[R, B, critic inputs]"""
    terminal: Tensor
    """[R, B]: 1.0 where no reward follows the transition, else 0.0"""
    cost_terminal: Tensor
    """[R, B]: 1.0 where no cost follows it that counts, else 0.0"""


class Replay:
    """The first `kept` and the last transitions of every run, `capacity` in all; a transition in
    one row, so that one gather fetches a whole batch."""

    def __init__(
        self,
        runs: int,
        capacity: int,
        observation_size: int,
        action_size: int,
        costs: int = 1,
        kept: int = 0,
    ) -> None:
        self._widths = [observation_size, action_size, 1, costs, observation_size, 1, 1]
        self._kept = kept
        self._rows = np.zeros((runs, capacity, sum(self._widths)), dtype=np.float32)
        self.stored = np.zeros(runs, dtype=np.int64)
        """Transitions stored so far, [R]; those beyond the capacity have replaced the oldest
        that are not kept."""

    @property
    def size(self) -> NDArray[np.int64]:
        """Transitions held, [R]."""
        return np.minimum(self.stored, self._rows.shape[1])

    def add(self, rollout: Rollout, terminal: NDArray, cost_terminal: NDArray) -> None:
        """Store the steps of a rollout; terminal, cost_terminal: [T, R], see `Batch`."""
        columns = (rollout.observation, rollout.action, rollout.reward, rollout.cost)
        columns = (*columns, rollout.next_observation, terminal, cost_terminal)
        steps, runs = terminal.shape
        rows = np.concatenate([c.reshape(steps, runs, -1) for c in columns], axis=-1)
        for run, length in enumerate(rollout.length):
            place = self.stored[run] + np.arange(length)
            ring = self._kept + (place - self._kept) % (self._rows.shape[1] - self._kept)
            self._rows[run, np.where(place < self._kept, place, ring)] = rows[:length, run]
        self.stored += rollout.length

    def gather(self, index: NDArray[np.int64]) -> Batch:
        """The transitions in slots index [R, B]; those kept come first."""
        rows = tensor(self._rows[np.arange(len(index))[:, None], index])
        parts = (part.contiguous() for part in rows.split(self._widths, dim=-1))
        observation, action, reward, cost, next_observation, *ends = parts
        terminal, cost_terminal = (end[..., 0] for end in ends)
        # A clone, not `contiguous`: with one cost that would keep strides of its own, and one run
        # beside its copy would be compiled anew, to other last bits.
        cost = cost.transpose(1, 2).clone(memory_format=torch.contiguous_format)
        return Batch(
            observation, action, reward[..., 0], cost, next_observation, terminal, cost_terminal
        )

    def state_dict(self) -> dict[str, NDArray]:
        """The state for a checkpoint: the rows that are held, not the empty ones."""
        return {"rows": self._rows[:, : self.size.max(initial=0)], "stored": self.stored}

    def load_state_dict(self, state: dict[str, NDArray]) -> None:
        """Load a state. ValueError or KeyError for anything else."""
        self.stored = tree.expect("stored", state, self.stored.shape, np.int64).copy()
        held = int(self.size.max(initial=0))
        shape = (len(self.stored), held, self._rows.shape[2])
        self._rows[:, :held] = tree.expect("rows", state, shape, np.float32)
