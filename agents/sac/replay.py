"""Memory of runs: replay buffer, recent episodes, states seen, and the scale of returns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from agents.lockstep import tree
from agents.lockstep.noise import Purpose, streams
from agents.lockstep.normalizer import RunningMoments
from agents.lockstep.rollout import Rollout


class Batch(NamedTuple):
    """Transitions from the replay buffer: arrays, or tensors where PyTorch differentiates a
    rule."""

    observation: Any
    """[R, B, critic inputs]: observations and what only critics see, see `critic_inputs`"""
    action: Any
    """[R, B, action size], in [-1, 1]"""
    reward: Any
    """[R, B]"""
    cost: Any
    """[R, C, B]"""
    next_observation: Any
    """[R, B, critic inputs]"""
    terminal: Any
    """[R, B]: 1.0 where the reward critics do not bootstrap, else 0.0"""
    cost_terminal: Any
    """[R, B]: 1.0 where the cost critics do not bootstrap, else 0.0"""


class Replay:
    """Replay buffer: the first `kept` and the latest transitions of every run, `capacity` in all. A
    transition is one row, so that one gather fetches a whole batch."""

    def __init__(
        self,
        runs: int,
        capacity: int,
        observation_size: int,
        action_size: int,
        costs: int = 1,
        kept: int = 0,
    ) -> None:
        widths = [observation_size, action_size, 1, costs, observation_size, 1, 1]
        ends = np.cumsum(widths)
        self._columns = [slice(end - own, end) for own, end in zip(widths, ends, strict=True)]
        self._kept = kept
        self._rows = np.zeros((runs, capacity, sum(widths)), dtype=np.float32)
        self.stored = np.zeros(runs, dtype=np.int64)
        """Transitions stored so far, [R]; beyond the capacity each replaces the oldest that is not
        kept."""

    @property
    def size(self) -> NDArray[np.int64]:
        """Number of transitions held, [R]."""
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
        """Return the transitions in slots index [R, B]; kept transitions come first."""
        runs, capacity, width = self._rows.shape
        of_run = capacity * np.arange(runs)[:, None]
        rows = self._rows.reshape(-1, width).take(of_run + index, axis=0)
        observation, action, reward, cost, following, *ends = (
            rows[..., own] for own in self._columns
        )
        reward, *ends = (np.ascontiguousarray(column[..., 0]) for column in (reward, *ends))
        cost = np.ascontiguousarray(cost.transpose(0, 2, 1))
        return Batch(observation, action, reward, cost, following, *ends)

    def state_dict(self) -> dict[str, NDArray]:
        """Return the state for a checkpoint, without empty rows."""
        return {"rows": self._rows[:, : self.size.max(initial=0)], "stored": self.stored}

    def load_state_dict(self, state: dict[str, NDArray]) -> None:
        """Load a state. Raises KeyError or ValueError if it does not fit."""
        self.stored = tree.expect("stored", state, self.stored.shape, np.int64).copy()
        held = int(self.size.max(initial=0))
        shape = (len(self.stored), held, self._rows.shape[2])
        self._rows[:, :held] = tree.expect("rows", state, shape, np.float32)


STARTS, EPISODES = 64, 10
"""Numbers of last episodes whose start states and whose costs are kept."""


class Recent:
    """Start states and undiscounted costs of the last episodes of each of R runs."""

    def __init__(self, runs: int, observation_size: int, costs: int) -> None:
        self._starts = np.zeros((runs, STARTS, observation_size), dtype=np.float32)
        self._costs = np.zeros((runs, EPISODES, costs))
        self._count = np.zeros(runs, dtype=np.int64)

    def add(self, rollout: Rollout) -> None:
        """Keep the episodes [T, R, ...], one of each run, whose length is not 0."""
        costs = rollout.cost_returns
        for run in np.flatnonzero(rollout.length):
            self._starts[run, self._count[run] % STARTS] = rollout.observation[0, run]
            self._costs[run, self._count[run] % EPISODES] = costs[run]
            self._count[run] += 1

    @property
    def starts(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Start states [R, STARTS, observation size], and weights [R, STARTS]: equal for the states
        held, 0 for empty slots, with sum 1."""
        held = np.arange(STARTS) < self._count[:, None]
        weight = held / np.maximum(held.sum(axis=1, keepdims=True), 1)
        return self._starts, weight.astype(np.float32)

    def costs(self, of: Callable[[NDArray[np.float64]], float]) -> NDArray[np.float32]:
        """Apply `of` to each cost of a run's recent episodes, [E]: [R, C]; 0 without episodes."""
        held = [costs[:count] for costs, count in zip(self._costs, self._count, strict=True)]
        found = [[of(own) if len(own) else 0.0 for own in costs.T] for costs in held]
        return np.array(found, dtype=np.float32)

    def state_dict(self) -> dict[str, NDArray]:
        """Return the state for a checkpoint."""
        return {"starts": self._starts, "costs": self._costs, "count": self._count}

    def load_state_dict(self, state: dict[str, NDArray]) -> None:
        """Load a state. Raises KeyError or ValueError if it does not fit."""
        for name, own in self.state_dict().items():
            own[...] = tree.expect(name, state, own.shape, own.dtype)


FEATURES = 128
"""Number of features of a state. With more, more places can be told apart."""


class Novelty:
    """How new states are to each of R runs.

    A state is represented by random Fourier features φ of norm 1 (Rahimi and Recht 2007): the inner
    product of two states' features is about exp(-d² / (2 ℓ²)), d being their distance. With
    `A = I + Σ φ φᵀ` over all states that a run has seen, the novelty of a state is √(φᵀ A⁻¹ φ), the
    bonus of LSVI-UCB (Jin et al. 2020), whose square E3B takes within an episode (Henaff et al.
    2022): about 1 where nothing within ℓ was seen, and 1/√(1 + n) at the only place that was seen,
    n times.
    """

    def __init__(self, length: float, seeds: Sequence[int], state_size: int) -> None:
        """length: ℓ, in the units of the states; seeds: [R], those of the runs."""
        shape = (state_size, FEATURES // 2)
        drawn = [rng.standard_normal(shape) for rng in streams(seeds, Purpose.NOVELTY, 0)]
        self._frequencies = (np.stack(drawn) / length).astype(np.float32)
        self._seen = np.tile(np.eye(FEATURES), (len(seeds), 1, 1))
        self._inverse = self._seen.astype(np.float32)

    def add(self, states: NDArray[np.float32], length: NDArray[np.int64]) -> None:
        """Count the first `length` [R] of the states [T, R, ...] as seen."""
        for run, steps in enumerate(length):
            features = self._features(states[:steps, run], run).astype(np.float64)
            self._seen[run] += features.T @ features
        self._inverse = _inverses(self._seen)

    def of(self, states: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the novelty of states [R, B, ...], [R, B] in [0, 1]. What lies behind a state's
        numbers, such as streaks for the critics, does not count."""
        features = self._features(states)
        square = ((features @ self._inverse) * features).sum(axis=-1)
        return np.sqrt(np.maximum(square, 0.0))  # rounding may leave it below 0

    def _features(
        self, states: NDArray[np.float32], run: int | slice = slice(None)
    ) -> NDArray[np.float32]:
        frequencies = self._frequencies[run]
        angle = states[..., : frequencies.shape[-2]] @ frequencies
        scale = np.float32(np.sqrt(2.0 / FEATURES))
        return scale * np.concatenate([np.cos(angle), np.sin(angle)], axis=-1)

    def state_dict(self) -> dict[str, NDArray]:
        """Return the state for a checkpoint."""
        return {"seen": self._seen}

    def load_state_dict(self, state: dict[str, NDArray]) -> None:
        """Load a state. Raises KeyError or ValueError if it does not fit."""
        self._seen = tree.expect("seen", state, self._seen.shape, np.float64).copy()
        self._inverse = _inverses(self._seen)


class ReturnScale:
    """Standard deviation of the discounted return in each of R runs, over all steps so far.

    The return of a step is `G_t = r_t + γ G_{t-1}`, from the start of its episode on. Rewards
    divided by that deviation and clipped to ±10 have a similar scale on every task, as in
    `NormalizeReward` of gymnasium and `VecNormalize` of Stable-Baselines3.
    """

    def __init__(self, runs: int, discount: float) -> None:
        self._discount = discount
        self._moments = RunningMoments(runs)

    def add(self, reward: NDArray[np.float64], length: NDArray[np.int64]) -> None:
        """Count the first `length` [R] of the rewards [T, R] of an episode."""
        returns = np.zeros_like(reward)
        total = np.zeros(reward.shape[1])
        for t, now in enumerate(reward):
            total = returns[t] = now + self._discount * total
        for run, steps in enumerate(length):
            if steps:
                self._moments.add(run, np.ascontiguousarray(returns[:steps, run]))

    def of(self, reward: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return rewards [R, B] in the current scale, for runs that have counted steps."""
        deviation = np.sqrt(self._moments.variance + 1e-8)
        return np.clip(reward / deviation[:, None], -10.0, 10.0).astype(np.float32)

    def state_dict(self) -> dict[str, NDArray]:
        """Return the state for a checkpoint."""
        return self._moments.state_dict()

    def load_state_dict(self, state: dict[str, NDArray]) -> None:
        """Load a state. Raises KeyError or ValueError if it does not fit."""
        self._moments.load_state_dict(state)


def _inverses(matrices: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return the inverses, by PyTorch, which `configure` keeps to one thread: the last bits of
    NumPy's depend on the number of threads."""
    return torch.linalg.inv(torch.from_numpy(matrices)).numpy().astype(np.float32)
