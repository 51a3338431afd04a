"""The records of a training: one row per run and epoch."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from agents.lockstep.rollout import Rollout
from agents.runs.files import write_whole
from emcc import EpisodeRecords, longest_streaks


class Log:
    """What each epoch of each run gave: its episode, and the means of its gradient steps."""

    COLUMNS = ("start_step", "length", "return", "cost", "longest_streak")

    def __init__(self, metrics: Sequence[str], runs: int) -> None:
        self.metrics, self.runs = tuple(metrics), runs
        self._epochs: list[NDArray[np.float64]] = []

    def add(self, rollout: Rollout, start_step: NDArray[np.int64], metrics: NDArray) -> None:
        """Record an epoch. rollout: of all runs; start_step: [R], -1 for a run that is done;
        metrics: [R, metrics]."""
        costs = rollout.cost.T[rollout.during.T]
        streaks = longest_streaks(costs, rollout.length)
        columns = (start_step, rollout.length, rollout.returns, rollout.cost_returns, streaks)
        self._epochs.append(np.column_stack((*columns, metrics)).astype(np.float64))

    def table(self) -> NDArray[np.float64]:
        """Everything: [epochs, R, columns and metrics]."""
        width = len(self.COLUMNS) + len(self.metrics)
        return np.array(self._epochs).reshape(-1, self.runs, width)

    def restore(self, table: NDArray[np.float64]) -> None:
        """Take over what `table` returned."""
        self._epochs = list(table)

    def recent(self, epochs: int = 20) -> NDArray[np.float64]:
        """Return and cost return, means over the last epochs and all runs: [2]."""
        return np.mean(self._epochs[-epochs:], axis=(0, 1))[2:4]

    def write(self, folders: Sequence[Path]) -> None:
        """Write `episodes.csv` and `updates.csv` into the folder of each run."""
        table = self.table()
        for run, folder in enumerate(folders):
            epochs = np.flatnonzero(table[:, run, 0] >= 0)
            rows = table[epochs, run]
            start, length, returns, cost, streak = rows[:, :5].T
            records = EpisodeRecords(epochs, start, length, returns, cost, streak)
            records.save(folder / "episodes.csv")
            write_whole(folder / "updates.csv", self._updates(epochs, rows))

    def _updates(self, epochs: NDArray[np.int64], rows: NDArray[np.float64]) -> str:
        """CSV of the epochs that had gradient steps; `step`: environment steps taken by then."""
        learned = ~np.isnan(rows[:, len(self.COLUMNS) :]).all(axis=1)
        epochs, rows = epochs[learned], rows[learned]
        steps = (rows[:, 0] + rows[:, 1]).astype(np.int64)
        lines = [",".join(("rollout", "step", *self.metrics))]
        values = rows[:, len(self.COLUMNS) :].astype(np.float32)
        for epoch, step, row in zip(epochs, steps, values, strict=True):
            lines.append(",".join((str(epoch), str(step), *map(str, row))))
        return "\n".join([*lines, ""])
