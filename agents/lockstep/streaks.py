"""A limit of the longest streak: the record cost as a further cost, and its tail."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from agents.checks import In, Settings
from agents.errors import UserError
from agents.lockstep import tree
from agents.lockstep.rollout import Rollout
from emcc import worst
from emcc.augmented import augmented
from emcc.streak_cost import Longest, record_name

EPISODES = 100
"""Number of a run's last episodes over which the quantile is taken."""
RECENT = 10
"""Number of a run's last episodes that an off-policy multiplier follows."""
SEEN = 2
"""How many numbers about streaks observations end with."""


class Streaks(Longest):
    """Streaks of the first cost; `collect` marks episodes with invalid costs as failed."""

    strict = False


@dataclass(frozen=True)
class StreakLimit(Settings):
    """A second constraint: the longest streak."""

    streak_limit: Annotated[float, In(0, 1e9)] | None = None
    """Limit, in steps, of an episode's longest streak of cost steps, mean over an epoch's episodes,
    off-policy over the last 10: a second cost, `record_cost`, with a multiplier of its own. Policy
    and critics then see the current and the longest streak so far, both divided by 20. Not in the
    paper; None: none."""

    def __post_init__(self) -> None:
        """Check the values. Raises UserError naming one that is not allowed."""
        super().__post_init__()
        weight = getattr(self, "streak_weight", 0.0)
        if self.streak_limit is not None and weight:
            raise UserError(
                "streak_weight must be 0 with a streak_limit, whose cost has no weight, "
                f"got {weight}"
            )

    def added_costs(self, costs: tuple[str, ...]) -> tuple[str, ...]:
        """Return the names of the costs that `wrap` adds."""
        return () if self.streak_limit is None else (record_name(costs[0]),)

    def wrap(self, env: Any, costs: tuple[str, ...], time_limit: int | None) -> Any:
        """Return the environment; if streaks are limited, its observations end with those of the
        first cost."""
        return env if self.streak_limit is None else augmented(env, Streaks(cost=costs[0]))


@dataclass(frozen=True)
class StreakTailLimit(StreakLimit):
    """The constraint for algorithms with a multiplier, which can follow the tail of the streaks."""

    streak_alpha: Annotated[float, In(above=0, high=1)] = 1.0
    """Share α of episodes with the longest streaks whose mean `streak_limit` limits: CVaR_α of the
    longest streak, with the quantile from the run's last 100 episodes. Not in the paper; 1: all
    episodes."""

    def __post_init__(self) -> None:
        """Check the values. Raises UserError naming one that is not allowed."""
        super().__post_init__()
        if self.streak_limit is None and self.streak_alpha != 1:
            raise UserError(f"streak_alpha needs a streak_limit, got {self.streak_alpha} alone")


class StreakTail:
    """The (1 - α) quantile η of the longest streaks in the last episodes, for each of R runs.

    In an episode with the longest streak L, the record costs beyond η sum to `(L - η)₊`, and
    `CVaR_α(L) = η + E[(L - η)₊] / α`. Source: Rockafellar & Uryasev 2000, "Optimization of
    conditional value-at-risk", theorem 1.
    """

    def __init__(self, runs: int, alpha: float) -> None:
        self._alpha = alpha
        self._last = np.full((runs, EPISODES), np.nan)

    def count(self, rollout: Rollout) -> None:
        """Count the N = R·E episodes of an epoch, whose last cost is the record cost."""
        runs = len(self._last)
        longest = rollout.cost_returns[:, -1].reshape(runs, -1)
        for run in np.flatnonzero(rollout.length.reshape(runs, -1).any(axis=1)):
            self._last[run] = np.concatenate([self._last[run], longest[run]])[-EPISODES:]

    @property
    def level(self) -> NDArray[np.float64]:
        """η, [R]: 0 for a run without episodes, and where all episodes count (α = 1)."""
        level = np.zeros(len(self._last))
        for run, last in enumerate(self._last if self._alpha < 1 else ()):
            held = last[~np.isnan(last)]
            level[run] = held[worst(held, self._alpha, "all")].min() if len(held) else 0.0
        return level

    @property
    def recent(self) -> NDArray[np.float64]:
        """`η + E[(L - η)₊] / α` over the `RECENT` last episodes, [R]; 0 for a run without
        episodes."""
        level, own = self.level, self._last[:, -RECENT:]
        beyond = np.maximum(np.nan_to_num(own) - level[:, None], 0.0).sum(axis=1)
        count = np.maximum((~np.isnan(own)).sum(axis=1), 1)
        return level + beyond / count / self._alpha

    def of(self, rollout: Rollout) -> tuple[Rollout, NDArray[np.float64]]:
        """Count an epoch's episodes; return the rollout with record costs only beyond η, divided by
        α, and η, [R]."""
        self.count(rollout)
        level = self.level
        longest = longest_at_records(rollout)
        each = np.repeat(level, longest.shape[1] // len(level))
        return with_last_cost(rollout, (longest > each) / self._alpha), level

    def beyond(self, longest: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return record costs only beyond η, over α, from `longest_at_records` of steps [R, B]."""
        return ((longest > self.level[:, None]) / self._alpha).astype(np.float32)

    def state_dict(self) -> dict[str, NDArray]:
        """The state for a checkpoint."""
        return {"longest_streaks": self._last}

    def load_state_dict(self, state: dict[str, NDArray]) -> None:
        """Load a state. ValueError or KeyError for anything else."""
        name = "longest_streaks"
        self._last = tree.expect(name, state, self._last.shape, np.float64).copy()


def longest_at_records(rollout: Rollout) -> NDArray[np.float64]:
    """Return, [T, N], the longest streak so far at steps with a record cost, the last of the costs,
    and 0 at all others. With any later η, this tells which steps count."""
    record = rollout.cost[..., -1]
    return record * np.cumsum(record, axis=0)


def with_last_cost(rollout: Rollout, values: NDArray) -> Rollout:
    """Return the rollout with values [T, N] instead of its last cost."""
    cost = rollout.cost.copy()
    cost[..., -1] = values
    return rollout._replace(cost=cost)
