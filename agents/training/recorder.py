"""All that happens in a training between two checkpoints, run by run."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from agents.lockstep.rollout import Rollout
from agents.training.config import RunId
from emcc import longest_streaks

RECENT = 20
"""Epochs over which progress shows means."""


class Recorder:
    """Steps, episodes and updates of every run since `take`.

    Arrays of a run, below its prefix: of every step "costs/NAME" [steps] and what its task's
    environments record (`RecordSteps.recorded`), "positions" [steps, 2] and "info/NAME" [steps];
    "length" and "return" of every episode; "updates" [epochs, metrics], NaN where nothing was
    learned.
    """

    def __init__(
        self, runs: Sequence[RunId], episodes: int, metrics: Sequence[str], costs: Sequence[str]
    ) -> None:
        """episodes: of a run in an epoch; metrics: names of the numbers of an update."""
        self.runs, self.episodes, self.metrics, self.costs = runs, episodes, metrics, costs
        self._new: dict[str, list[NDArray]] = {}
        self._recent: deque[tuple[float, float]] = deque(maxlen=RECENT)
        self.latest: dict[RunId, dict[str, float]] = {}
        """Numbers of the last epoch of each run that took part: "return", "cost", "length" (means
        over its episodes), "mcc", further costs by their names, and the metrics that are there."""

    def add(
        self,
        rollout: Rollout,
        recorded: Sequence[Mapping[str, NDArray[np.float32]]],
        active: NDArray[np.bool_],
        metrics: NDArray,
    ) -> None:
        """Add an epoch.

        rollout: of R·E episodes; recorded: arrays [T, E, ...] for each run; active: [R], runs that
        took part; metrics: [R, metrics] of their updates.
        """
        shape = (len(self.runs), self.episodes)
        lengths, returns = rollout.length.reshape(shape), rollout.returns.reshape(shape)
        costs = rollout.cost.reshape(len(rollout.cost), *shape, -1)
        totals = rollout.cost_returns.reshape(*shape, -1)
        self.latest = {}
        for k in np.flatnonzero(active).tolist():
            run = self.runs[k]
            during = [slice(0, n) for n in lengths[k]]
            for c, name in enumerate(self.costs):
                rows = [costs[steps, k, e, c] for e, steps in enumerate(during)]
                self._append(run, f"costs/{name}", *rows)
            for name, values in recorded[k].items():
                self._append(run, name, *[values[steps, e] for e, steps in enumerate(during)])
            self._append(run, "length", lengths[k].astype(np.int64))
            self._append(run, "return", returns[k].astype(np.float64))
            self._append(run, "updates", metrics[k][None].astype(np.float32))
            streaks = longest_streaks(
                np.concatenate([costs[s, k, e, 0] for e, s in enumerate(during)]), lengths[k]
            )
            numbers = {"return": returns[k].mean(), "cost": totals[k, :, 0].mean()}
            numbers |= {"length": lengths[k].mean(), "mcc": (streaks / lengths[k]).max()}
            numbers |= {name: totals[k, :, c].mean() for c, name in enumerate(self.costs) if c > 0}
            named = zip(self.metrics, metrics[k], strict=True)
            numbers |= {name: value for name, value in named if not np.isnan(value)}
            self.latest[run] = {name: float(value) for name, value in numbers.items()}
        if active.any():
            self._recent.append((returns[active].mean(), totals[active, :, 0].mean()))

    def _append(self, run: RunId, name: str, *rows: NDArray) -> None:
        self._new.setdefault(run.prefix + name, []).extend(rows)

    def take(self) -> dict[str, NDArray]:
        """The new arrays by name; they are forgotten here."""
        arrays = {name: np.concatenate(rows) for name, rows in self._new.items()}
        self._new = {}
        return {"metrics": np.array(self.metrics, dtype=np.str_), **arrays}

    @property
    def recent(self) -> tuple[float, float]:
        """Return and cost of the last epochs' episodes, means; NaN before the first."""
        if not self._recent:
            return np.nan, np.nan
        returns, costs = np.mean(self._recent, axis=0)
        return float(returns), float(costs)
