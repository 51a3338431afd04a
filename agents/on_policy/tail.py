"""CVaR of the longest streak as a cost that adds up over steps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agents.lockstep import tree
from agents.lockstep.rollout import Rollout
from emcc import worst

EPISODES = 100
"""Last episodes of a run whose quantile counts."""


class StreakTail:
    """The (1 - α) quantile η of the longest streaks of R runs' last episodes.

    With the record costs c of an episode of the longest streak L, those beyond η add up to
    `(L - η)₊`, and `CVaR_α(L) = η + E[(L - η)₊] / α`. Source: Rockafellar & Uryasev 2000,
    "Optimization of conditional value-at-risk", theorem 1.
    """

    def __init__(self, runs: int, alpha: float) -> None:
        self._alpha = alpha
        self._last = np.full((runs, EPISODES), np.nan)

    def of(self, rollout: Rollout) -> tuple[Rollout, NDArray[np.float64]]:
        """Count an epoch's episodes, whose last cost is the record cost. The rollout with the
        record costs beyond η, over α; and η, [R]: 0 of a run without episodes."""
        runs = len(self._last)
        longest = rollout.cost_returns[:, -1].reshape(runs, -1)
        lengths = rollout.length.reshape(runs, -1)
        level = np.zeros(runs)
        for run in np.flatnonzero(lengths.any(axis=1)):
            self._last[run] = np.concatenate([self._last[run], longest[run]])[-EPISODES:]
            held = self._last[run][~np.isnan(self._last[run])]
            level[run] = held[worst(held, self._alpha, "all")].min()
        record = rollout.cost[..., -1]
        beyond = np.cumsum(record, axis=0) > np.repeat(level, longest.shape[1])
        cost = rollout.cost.copy()
        cost[..., -1] = record * beyond / self._alpha
        return rollout._replace(cost=cost), level

    def state_dict(self) -> dict[str, NDArray]:
        """The state for a checkpoint."""
        return {"longest_streaks": self._last}

    def load_state_dict(self, state: dict[str, NDArray]) -> None:
        """Load a state. ValueError or KeyError for anything else."""
        name = "longest_streaks"
        self._last = tree.expect(name, state, self._last.shape, np.float64).copy()
