"""Costs and positions of every step of a training, in .npy files that grow."""

from __future__ import annotations

import io
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from agents.errors import UserError
from agents.lockstep.rollout import Rollout

COSTS, VISITED = "costs.npy", "visited.npy"
"""In the folder of a run: the cost of every step, [steps] float64, and the position it ended at,
[steps, 2] float32 in the units of the task's view. Row k is step k of the training, so an episode
of `episodes.csv` has the rows from its `start_step` on."""


class StepFiles:
    """Steps of the runs since the last `write`, and how many were written before.

    with_positions: whether positions are recorded beside the costs.
    """

    def __init__(self, with_positions: bool, runs: int) -> None:
        positions = {VISITED: np.empty((0, 2), np.float32)} if with_positions else {}
        empty = {COSTS: np.empty(0)} | positions
        self._new: list[dict[str, list[NDArray]]] = [
            {name: [rows] for name, rows in empty.items()} for _ in range(runs)
        ]
        self.written = np.zeros(runs, dtype=np.int64)
        """Rows in the files of each run, [R]; more, left by a killed process, are overwritten."""

    def add(
        self, rollout: Rollout, active: NDArray[np.bool_], positions: NDArray[np.float32] | None
    ) -> None:
        """Add an epoch.

        rollout: of R·E episodes; active: [R], runs that it belongs to; positions: [T, R·E, 2] or
        None, as recorded.
        """
        runs = len(active)
        length = rollout.length.reshape(runs, -1)
        columns: dict[str, NDArray] = {COSTS: rollout.cost}
        if positions is not None:
            columns[VISITED] = positions
        for run in np.flatnonzero(active):
            for episode, steps in enumerate(length[run]):
                for name, column in columns.items():
                    rows = column[:steps, run * length.shape[1] + episode]
                    self._new[run][name].append(rows)

    def write(self, folders: Sequence[Path]) -> None:
        """Append what is new to the files in the folder of each run."""
        for run, folder in enumerate(folders):
            rows = {name: np.concatenate(new) for name, new in self._new[run].items()}
            for name, new in rows.items():
                _append(folder / name, int(self.written[run]), new)
                self._new[run][name] = [new[:0]]
            self.written[run] += len(rows[COSTS])

    def seek(self, folders: Sequence[Path], rows: NDArray[np.int64]) -> None:
        """Go on behind `rows`, [R]. Raises UserError where a file does not hold as many."""
        for run, (folder, count) in enumerate(zip(folders, rows, strict=True)):
            for name, (like, *_) in self._new[run].items():
                path = folder / name
                least = len(_header(like, 0)) + int(count) * _row_bytes(like)
                if not path.exists() or path.stat().st_size < least:
                    raise UserError(f"{path} is missing or damaged: must hold {count} steps")
        self.written = rows.copy()


def read_steps(folder: Path, name: str) -> NDArray:
    """`COSTS` or `VISITED` of a run. Raises UserError where the file is missing or damaged."""
    path = folder / name
    try:
        return np.load(path, mmap_mode="r", allow_pickle=False)
    except FileNotFoundError:
        raise UserError(f"{path} is missing: the run has no record of its steps") from None
    except (OSError, ValueError, EOFError) as error:
        raise UserError(f"{path} is damaged: {error}") from None


def _append(path: Path, rows: int, new: NDArray) -> None:
    """Write rows behind the first `rows` of a file, and only then its header, which counts them."""
    with path.open("r+b" if path.exists() else "w+b") as file:
        file.seek(len(_header(new, 0)) + rows * _row_bytes(new))
        file.write(new.astype(new.dtype.newbyteorder("<")).tobytes())
        file.truncate()
        file.flush()
        os.fsync(file.fileno())
        file.seek(0)
        file.write(_header(new, rows + len(new)))


def _row_bytes(like: NDArray) -> int:
    return like.dtype.itemsize * int(np.prod(like.shape[1:]))


def _header(like: NDArray, rows: int) -> bytes:
    """The beginning of a .npy file of rows as in `like`; numpy keeps it as long for any number."""
    buffer = io.BytesIO()
    kind = like.dtype.newbyteorder("<").str
    description = {"descr": kind, "fortran_order": False, "shape": (rows, *like.shape[1:])}
    npy.write_array_header_1_0(buffer, description)
    return buffer.getvalue()
