"""The records of a training: a row per episode, and the numbers of each epoch's update."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.lockstep import tree
from agents.lockstep.rollout import Rollout
from emcc import EpisodeRecords, count_streaks, longest_streaks

COLUMNS = ("start_step", "length", "return", "cost", "longest_streak", "cost_steps", "streaks")


class Log:
    """Episodes and updates of each epoch of each run."""

    def __init__(self, runs: int, episodes: int, metrics: Sequence[str]) -> None:
        self.metrics = tuple(metrics)
        self._shapes = (runs, episodes, len(COLUMNS)), (runs, len(metrics))
        self._episodes: list[NDArray[np.float64]] = []
        self._updates: list[NDArray[np.float64]] = []

    def add(
        self,
        rollout: Rollout,
        steps: NDArray[np.int64],
        active: NDArray[np.bool_],
        metrics: NDArray,
    ) -> None:
        """Record an epoch. rollout: of R·E episodes; steps: [R], those each run had taken before;
        active: [R], runs that took part; metrics: [R, metrics], NaN where nothing was learned.
        """
        runs, episodes, _ = self._shapes[0]
        length = rollout.length.reshape(runs, episodes)
        start = steps[:, None] + np.cumsum(length, axis=1) - length
        streaks = np.zeros((3, runs * episodes), dtype=np.int64)
        kept = np.repeat(active, episodes)
        if kept.any():
            costs = rollout.cost.T[(rollout.during & kept).T], rollout.length[kept]
            streaks[:, kept] = longest_streaks(*costs), *count_streaks(*costs)
        columns = (start.ravel(), rollout.length, rollout.returns, rollout.cost_returns, *streaks)
        rows = np.column_stack(columns).astype(np.float64).reshape(self._shapes[0])
        self._episodes.append(np.where(active[:, None, None], rows, np.nan))
        self._updates.append(np.where(active[:, None], metrics, np.nan).astype(np.float64))

    @property
    def episodes(self) -> NDArray[np.float64]:
        """[epochs, R, E, columns]; NaN where a run took no part."""
        return np.array(self._episodes).reshape(-1, *self._shapes[0])

    @property
    def updates(self) -> NDArray[np.float64]:
        """[epochs, R, metrics]; NaN where a run learned nothing."""
        return np.array(self._updates).reshape(-1, *self._shapes[1])

    @property
    def steps(self) -> NDArray[np.int64]:
        """Environment steps recorded of each run, [R]."""
        length = self.episodes[..., COLUMNS.index("length")]
        return np.nansum(length, axis=(0, 2)).astype(np.int64)

    def latest_numbers(self) -> list[dict[str, float]]:
        """Numbers of the last epoch of each run: "return", "cost", "length" (means over its
        episodes), "mcc", and the metrics that are there; empty for a run that took no part."""
        found = []
        for rows, update in zip(self._episodes[-1], self._updates[-1], strict=True):
            _, length, returns, cost, streak, *_ = rows.T
            numbers = {"return": returns.mean(), "cost": cost.mean(), "length": length.mean()}
            numbers |= {"mcc": (streak / length).max()}
            metrics = zip(self.metrics, update, strict=True)
            numbers |= {name: value for name, value in metrics if not np.isnan(value)}
            took_part = not np.isnan(rows).any()
            found.append({k: float(v) for k, v in numbers.items()} if took_part else {})
        return found

    def state_dict(self) -> dict[str, NDArray]:
        """Everything, as named arrays."""
        return {"log.episodes": self.episodes, "log.updates": self.updates}

    def load_state_dict(self, state: dict[str, NDArray], epochs: int) -> None:
        """Load a state. ValueError or KeyError for anything else."""
        of_episodes, of_updates = ((epochs, *shape) for shape in self._shapes)
        episodes = tree.expect("log.episodes", state, of_episodes, np.float64)
        updates = tree.expect("log.updates", state, of_updates, np.float64)
        self._episodes, self._updates = list(episodes), list(updates)

    def recent(self, epochs: int = 20) -> tuple[float, float]:
        """Return and cost return, means over the last epochs of the runs that took part."""
        rows = np.array(self._episodes[-epochs:])[..., 2:4].reshape(-1, 2)
        rows = rows[~np.isnan(rows[:, 0])]
        returns, cost = rows.mean(axis=0) if len(rows) else (np.nan, np.nan)
        return float(returns), float(cost)

    def files(self) -> list[dict[str, bytes]]:
        """The content of `episodes.csv` and `updates.csv` of each run."""
        episodes, updates = self.episodes, self.updates
        found: list[dict[str, bytes]] = []
        for run in range(episodes.shape[1]):
            epochs = np.flatnonzero(~np.isnan(episodes[:, run, 0, 0]))
            rows = episodes[epochs, run]
            rollout = np.repeat(epochs, rows.shape[1])
            columns: Any = rows.reshape(-1, len(COLUMNS)).T  # the class types each anew
            records = EpisodeRecords(rollout, *columns)
            steps = rows[:, :, 1].sum(axis=1).cumsum().astype(np.int64)
            table = self._table(epochs, steps, updates[epochs, run])
            texts = {"episodes.csv": records.to_csv(), "updates.csv": table}
            found.append({name: text.encode() for name, text in texts.items()})
        return found

    def _table(self, epochs: NDArray[np.int64], steps: NDArray[np.int64], values: NDArray) -> str:
        """CSV of the epochs that learned something; `step`: environment steps taken by then."""
        lines = [",".join(("rollout", "step", *self.metrics))]
        for epoch, step, row in zip(epochs, steps, values.astype(np.float32), strict=True):
            if not np.isnan(row).all():
                lines.append(",".join((str(epoch), str(step), *map(str, row))))
        return "\n".join([*lines, ""])
