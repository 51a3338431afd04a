"""Where the agents of a training were: the position after every step, in files that grow."""

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
from circle2d_mj import Circle2DConfig
from circle2d_mj.task import position

FILE = "visited.npy"
"""In the folder of a run: [steps, 2] float32, world units. Row k is where step k of the training
ended, so an episode of `episodes.csv` has the rows from its `start_step` on."""
_ROW = 2 * 4
"""Bytes."""


class Visited:
    """What the runs have visited since the last `write`, and how much was written before."""

    def __init__(self, task: Circle2DConfig, runs: int) -> None:
        self._task = task
        self._new: list[list[NDArray[np.float32]]] = [[] for _ in range(runs)]
        self.written = np.zeros(runs, dtype=np.int64)
        """Rows in the file of each run, [R]; more, left by a killed process, are overwritten."""

    def add(self, rollout: Rollout, active: NDArray[np.bool_]) -> None:
        """Take in an epoch. rollout: of R·E episodes; active: [R], runs that it belongs to."""
        runs = len(active)
        length = rollout.length.reshape(runs, -1)
        where = position(self._task, rollout.next_observation).astype(np.float32)
        for run in np.flatnonzero(active):
            for episode, steps in enumerate(length[run]):
                self._new[run].append(where[:steps, run * length.shape[1] + episode])

    def write(self, folders: Sequence[Path]) -> None:
        """Add what is new to the file in the folder of each run."""
        for run, folder in enumerate(folders):
            rows = np.concatenate([np.empty((0, 2), np.float32), *self._new[run]])
            _append(folder / FILE, int(self.written[run]), rows)
            self.written[run] += len(rows)
            self._new[run] = []

    def restore(self, folders: Sequence[Path], rows: NDArray[np.int64]) -> None:
        """Go on behind `rows`, [R]. Raises UserError where a file does not hold as many."""
        for folder, count in zip(folders, rows, strict=True):
            path = folder / FILE
            least = len(_header(0)) + int(count) * _ROW
            if not path.exists() or path.stat().st_size < least:
                raise UserError(f"{path} is missing or damaged: must hold {count} positions")
        self.written = rows.copy()


def read_visited(folder: Path) -> NDArray[np.float32]:
    """The positions of a run, [steps, 2]. Raises UserError where they are missing or damaged."""
    path = folder / FILE
    try:
        return np.load(path, mmap_mode="r", allow_pickle=False)
    except FileNotFoundError:
        raise UserError(f"{path} is missing: the run has no record of where it was") from None
    except (OSError, ValueError, EOFError) as error:
        raise UserError(f"{path} is damaged: {error}") from None


def _append(path: Path, rows: int, new: NDArray[np.float32]) -> None:
    """Write rows behind the first `rows` of a file, and only then its header, which counts them."""
    with path.open("r+b" if path.exists() else "w+b") as file:
        file.seek(len(_header(0)) + rows * _ROW)
        file.write(new.astype("<f4").tobytes())
        file.truncate()
        file.flush()
        os.fsync(file.fileno())
        file.seek(0)
        file.write(_header(rows + len(new)))


def _header(rows: int) -> bytes:
    """The beginning of a .npy file; numpy keeps it as long for any number of rows."""
    buffer = io.BytesIO()
    description = {"descr": "<f4", "fortran_order": False, "shape": (rows, 2)}
    npy.write_array_header_1_0(buffer, description)
    return buffer.getvalue()
