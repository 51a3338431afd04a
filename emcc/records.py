"""What is kept of a training run: one row per trajectory, and its CSV file."""

import math
import os
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from emcc.arrays import as_array, as_integers
from emcc.csv_columns import parse, read_columns

COLUMNS = {  # of the CSV file, in the order of the fields of EpisodeRecords
    "rollout": int,
    "start_step": int,
    "length": int,
    "return": float,
    "cost": float,
    "longest_streak": int,
    "cost_steps": int,
    "streaks": int,
}
OPTIONAL = ("cost_steps", "streaks")
"""Columns that files of version 0.1 lack."""


@dataclass(frozen=True, eq=False, repr=False)
class EpisodeRecords:
    """The trajectories of a training run: parallel arrays [E], one row per trajectory, read-only.

    A trajectory is an episode, or a piece of one that was cut where a rollout ended.

    rollout: which rollout it belongs to, >= 0
    start_step: environment steps of the whole run that were taken before it started
    length: steps, >= 1
    reward: its undiscounted return (column `return` of the file)
    cost: sum of its costs, >= 0
    longest_streak: steps of its longest streak of cost steps, between 0 and length
    cost_steps: steps that cost, between longest_streak and length; None where not recorded
    streaks: streaks of cost steps, so that cost_steps / streaks is their mean length; likewise
    ValueError: arrays that are not 1-D and of one length, or a value that is not allowed.
    """

    rollout: NDArray[np.int64]
    start_step: NDArray[np.int64]
    length: NDArray[np.int64]
    reward: NDArray[np.float64]
    cost: NDArray[np.float64]
    longest_streak: NDArray[np.int64]
    cost_steps: NDArray[np.int64] | None = None
    streaks: NDArray[np.int64] | None = None

    def __post_init__(self) -> None:
        if (self.cost_steps is None) != (self.streaks is None):
            raise ValueError("cost_steps and streaks must be given together, or neither")
        for field, (column, number) in zip(fields(self), COLUMNS.items(), strict=True):
            if getattr(self, field.name) is None and column in OPTIONAL:
                continue
            array = as_array(getattr(self, field.name), column).copy()
            if number is int:
                array = as_integers(array, column, low=-math.inf)
            array = array.astype(np.float64 if number is float else np.int64, copy=False)
            array.flags.writeable = False
            object.__setattr__(self, field.name, array)
        shapes = sorted({array.shape for array in self._columns().values()})
        if len(shapes) > 1 or len(shapes[0]) != 1:
            raise ValueError(f"the arrays must be 1-D and of one length, got shapes {shapes}")
        self._check_rows()

    def _columns(self) -> dict[str, NDArray]:
        """The columns that there are, by their names in the file."""
        arrays = (getattr(self, field.name) for field in fields(self))
        found = zip(COLUMNS, arrays, strict=True)
        return {name: array for name, array in found if array is not None}

    def _check_rows(self) -> None:
        streak = self.longest_streak
        rules = [
            ("rollout", self.rollout, self.rollout >= 0, ">= 0"),
            ("start_step", self.start_step, self.start_step >= 0, ">= 0"),
            ("length", self.length, self.length >= 1, ">= 1"),
            ("return", self.reward, np.isfinite(self.reward), "finite"),
            ("cost", self.cost, np.isfinite(self.cost) & (self.cost >= 0), "finite and >= 0"),
            ("longest_streak", streak, (streak >= 0) & (streak <= self.length), "in [0, length]"),
        ]
        if self.cost_steps is not None and self.streaks is not None:
            steps, streaks = self.cost_steps, self.streaks
            # Streaks are apart by a safe step at least, and none is longer than the longest.
            possible = (-(-steps // np.maximum(streak, 1)) <= streaks) & (streak > 0)
            possible &= (streak + streaks - 1 <= steps) & (steps + streaks - 1 <= self.length)
            possible |= (steps == 0) & (streak == 0) & (streaks == 0)
            rules += [
                ("cost_steps", steps, (steps >= streak) & (steps <= self.length),
                 "in [longest_streak, length]"),
                ("streaks", streaks, possible, "possible with the other columns"),
            ]  # fmt: skip
        for column, values, allowed, rule in rules:
            if not allowed.all():
                row = int(np.argmin(allowed))
                raise _BadRow(row, f"column {column}: {values[row]} must be {rule}")

    def __len__(self) -> int:
        return len(self.rollout)

    def __repr__(self) -> str:
        rollouts = len(np.unique(self.rollout))
        sizes = f"{len(self)} trajectories, {rollouts} rollouts, {self.total_steps} steps"
        return f"EpisodeRecords({sizes})"

    @property
    def total_steps(self) -> int:
        """Environment steps of all trajectories together."""
        return int(self.length.sum())

    def mcc_per_rollout(self) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """MCC in [0, 1] and start step of each rollout, by rising id -> two arrays [D].

        A rollout starts where the first of its trajectories does. Source: equation (mcc).
        """
        rollouts, row_of = np.unique(self.rollout, return_inverse=True)
        mcc_values = np.zeros(len(rollouts))
        np.maximum.at(mcc_values, row_of, self.longest_streak / self.length)
        start_steps = np.full(len(rollouts), np.iinfo(np.int64).max)
        np.minimum.at(start_steps, row_of, self.start_step)
        return mcc_values, start_steps

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a CSV file, whole or not at all; equal records give equal bytes."""
        path = Path(path)
        columns = self._columns()
        rows = zip(*(array.tolist() for array in columns.values()), strict=True)
        lines = [",".join(columns), *(",".join(map(repr, row)) for row in rows), ""]
        # A fixed name: what a killed process left there, the next one overwrites.
        unfinished = path.with_name(f".{path.name}.unfinished")
        try:
            unfinished.write_text("\n".join(lines), encoding="utf-8", newline="\n")
            os.replace(unfinished, path)
        finally:
            unfinished.unlink(missing_ok=True)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "EpisodeRecords":
        """Read what `save` wrote, bit for bit.

        ValueError: a damaged file; the message names it with the line and column.
        """
        path = Path(path)
        columns = read_columns(path)
        if list(columns) not in (list(COLUMNS), [name for name in COLUMNS if name not in OPTIONAL]):
            raise ValueError(f"{path}: the header must be {','.join(COLUMNS)}")
        if not path.read_bytes().endswith(b"\n"):  # a number may have lost its last digits
            raise ValueError(f"{path}: the last line is cut off")
        try:
            return cls(*(parse(path, columns, name, COLUMNS[name]) for name in columns))
        except _BadRow as bad:
            raise ValueError(f"{path}, line {bad.row + 2}, {bad.problem}") from None


class _BadRow(ValueError):
    def __init__(self, row: int, problem: str) -> None:
        super().__init__(f"row {row}, {problem}")
        self.row, self.problem = row, problem
