"""What changes the rewards that are learned: a bonus for states that a run has seldom seen, and a
scale that follows the returns.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from agents.lockstep import tree
from agents.lockstep.noise import Purpose, streams

FEATURES = 128
"""Features of a state. More tell more places apart."""


class Novelty:
    """How new states are to each of R runs.

    Random Fourier features φ of norm 1 (Rahimi and Recht 2007) stand for a state: the product of
    those of two states at distance d is about exp(-d² / (2 ℓ²)). With A = I + Σ φ φᵀ over all
    states that a run has seen, the novelty of a state is √(φᵀ A⁻¹ φ), the bonus of LSVI-UCB (Jin et
    al. 2020), whose square E3B takes within an episode (Henaff et al. 2022): about 1 where nothing
    within ℓ was seen, and 1/√(1 + n) at the only place that was seen, n times.
    """

    def __init__(self, length: float, seeds: Sequence[int], state_size: int) -> None:
        """length: ℓ, in the units of the states; seeds: of the runs, [R]."""
        shape = (state_size, FEATURES // 2)
        drawn = [rng.standard_normal(shape) for rng in streams(seeds, Purpose.NOVELTY, 0)]
        self._frequencies = (np.stack(drawn) / length).astype(np.float32)
        self._seen = np.tile(np.eye(FEATURES), (len(seeds), 1, 1))
        self._inverse = self._seen.astype(np.float32)

    def add(self, states: NDArray[np.float32], length: NDArray[np.int64]) -> None:
        """Count the first length [R] of states [T, R, ...] as seen."""
        for run, steps in enumerate(length):
            features = self._features(states[:steps, run], run).astype(np.float64)
            self._seen[run] += features.T @ features
        self._inverse = _inverses(self._seen)

    def of(self, states: NDArray[np.float32]) -> NDArray[np.float32]:
        """Novelty of states [R, B, ...], in [0, 1]: [R, B]. What lies behind a state's numbers, as
        the streak for the critics, does not count."""
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
        """The state for a checkpoint."""
        return {"seen": self._seen}

    def load_state_dict(self, state: dict[str, NDArray]) -> None:
        """Load a state. ValueError or KeyError for anything else."""
        self._seen = tree.expect("seen", state, self._seen.shape, np.float64).copy()
        self._inverse = _inverses(self._seen)


class ReturnScale:
    """Standard deviation of the discounted return in each of R runs, over all steps so far.

    The return of a step is `G_t = r_t + γ G_{t-1}` from its episode's start on. Rewards over that
    deviation, cut at ±10, have a scale of their own on every task: as `NormalizeReward` of
    gymnasium and `VecNormalize` of Stable-Baselines3 do it.
    """

    def __init__(self, runs: int, discount: float) -> None:
        self._discount = discount
        self._moments = np.zeros((runs, 3))  # steps, mean, sum of squared deviations

    def add(self, reward: NDArray[np.float64], length: NDArray[np.int64]) -> None:
        """Count the first length [R] of the rewards [T, R] of an episode."""
        returns = np.zeros_like(reward)
        total = np.zeros(reward.shape[1])
        for t, now in enumerate(reward):
            total = returns[t] = now + self._discount * total
        for run, steps in enumerate(length):
            if steps:
                self._count(run, np.ascontiguousarray(returns[:steps, run]))

    def _count(self, run: int, returns: NDArray[np.float64]) -> None:
        """Join the moments of more returns to a run's (Chan et al. 1979)."""
        (before, mean, squares), more = self._moments[run], len(returns)
        after, change = before + more, returns.mean() - mean
        squares += ((returns - returns.mean()) ** 2).sum() + change**2 * before * more / after
        self._moments[run] = after, mean + change * more / after, squares

    def of(self, reward: NDArray[np.float32]) -> NDArray[np.float32]:
        """Rewards [R, B] in the scale of now; of a run that has counted steps."""
        steps, _, squares = self._moments.T
        deviation = np.sqrt(squares / np.maximum(steps, 1) + 1e-8)
        return np.clip(reward / deviation[:, None], -10.0, 10.0).astype(np.float32)

    def state_dict(self) -> dict[str, NDArray]:
        """The state for a checkpoint."""
        return {"moments": self._moments}

    def load_state_dict(self, state: dict[str, NDArray]) -> None:
        """Load a state. ValueError or KeyError for anything else."""
        self._moments = tree.expect("moments", state, self._moments.shape, np.float64).copy()


def _inverses(matrices: NDArray[np.float64]) -> NDArray[np.float32]:
    """By torch, which `configure` keeps to one thread: the last bits of numpy's depend on how many
    threads there are."""
    return torch.linalg.inv(torch.from_numpy(matrices)).numpy().astype(np.float32)
