"""Costs and positions of every step of a training, in .npy files that grow."""

from __future__ import annotations

import hashlib
import io
import os
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from agents.errors import UserError
from agents.lockstep.rollout import Rollout
from agents.training.checksums import check_digest

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
        self._hashes = [{name: hashlib.sha256() for name in empty} for _ in range(runs)]
        """Of all rows of each run: of those in the files, and of the new ones."""
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
                    self._hashes[run][name].update(_bytes(rows, self._new[run][name][0]))

    def write(self, folders: Sequence[Path]) -> None:
        """Append what is new to the files in the folder of each run."""
        for run, folder in enumerate(folders):
            rows = {name: np.concatenate(new) for name, new in self._new[run].items()}
            for name, new in rows.items():
                _append(folder / name, int(self.written[run]), new)
                self._new[run][name] = [new[:0]]
            self.written[run] += len(rows[COSTS])

    def digests(self) -> list[dict[str, str]]:
        """Checksums of the files of each run after the next `write`."""
        found: list[dict[str, str]] = []
        for run, hashes in enumerate(self._hashes):
            found.append({})
            for name, rows in self._new[run].items():
                hashed = hashes[name].copy()
                hashed.update(_header(rows[0], int(self.written[run]) + sum(map(len, rows))))
                found[-1][name] = hashed.hexdigest()
        return found

    def seek(self, folders: Sequence[Path], rows: NDArray[np.int64]) -> None:
        """Go on behind `rows`, [R]. Raises UserError where a file does not hold as many, or does
        not match its checksum."""
        for run, (folder, count) in enumerate(zip(folders, rows.tolist(), strict=True)):
            for name, (like, *_) in self._new[run].items():
                path = folder / name
                least = len(_header(like, 0)) + count * _row_bytes(like)
                if not path.exists() or path.stat().st_size < least:
                    raise UserError(f"{path} is missing or damaged: must hold {count} steps")
                found = _checked(path, like)
                if len(found) < count:
                    raise UserError(f"{path} is damaged: must hold {count} steps")
                self._hashes[run][name] = hashlib.sha256(_bytes(found[:count], like))
        self.written = rows.copy()


def read_steps(folder: Path, name: str) -> NDArray:
    """`COSTS` or `VISITED` of a run. Raises UserError where the file is missing or damaged."""
    like = np.empty(0) if name == COSTS else np.empty((0, 2), np.float32)
    return _checked(folder / name, like)


_found_whole: dict[Path, tuple[int, int, int]] = {}
"""Files that this process has compared with their checksums, and what the system said of them."""


def _checked(path: Path, like: NDArray) -> NDArray:
    """The rows of a file. Raises UserError where it is missing, of other rows, or damaged."""
    try:
        about = path.stat()
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # of a damaged header too
            rows: NDArray = np.load(path, mmap_mode="r", allow_pickle=False)
    except FileNotFoundError:
        raise UserError(f"{path} is missing: the run has no record of its steps") from None
    except Exception as error:  # a damaged file has numpy raise errors of any kind
        raise UserError(f"{path} is damaged: {error or type(error).__name__}") from None
    if not isinstance(rows, np.ndarray) or (rows.dtype, rows.shape[1:]) != (
        like.dtype,
        like.shape[1:],
    ):
        raise UserError(f"{path} is damaged: must hold {like.dtype} [steps{_of(like)}]")
    state = (about.st_mtime_ns, about.st_size, about.st_ino)
    if _found_whole.get(path) != state:
        try:
            hashed = hashlib.sha256(_bytes(rows, like))
            with path.open("rb") as file:
                hashed.update(file.read(len(_header(like, 0))))
            check_digest(path, hashed.hexdigest())
        except (OSError, ValueError) as error:
            raise UserError(str(error)) from None
        _found_whole[path] = state
    return rows


def _of(like: NDArray) -> str:
    return "".join(f", {size}" for size in like.shape[1:])


def _bytes(rows: NDArray, like: NDArray) -> memoryview:
    """Rows as they are in a file of rows as in `like`."""
    kind = like.dtype.newbyteorder("<")
    return np.ascontiguousarray(rows, kind).reshape(-1).view(np.uint8).data


def _append(path: Path, rows: int, new: NDArray) -> None:
    """Write rows behind the first `rows` of a file, and only then its header, which counts them."""
    with path.open("r+b" if path.exists() else "w+b") as file:
        file.seek(len(_header(new, 0)) + rows * _row_bytes(new))
        file.write(_bytes(new, new))
        file.truncate()
        file.flush()
        os.fsync(file.fileno())
        file.seek(0)
        file.write(_header(new, rows + len(new)))
        file.flush()
        os.fsync(file.fileno())


def _row_bytes(like: NDArray) -> int:
    return like.dtype.itemsize * int(np.prod(like.shape[1:]))


def _header(like: NDArray, rows: int) -> bytes:
    """The beginning of a .npy file of rows as in `like`; numpy keeps it as long for any number."""
    buffer = io.BytesIO()
    kind = like.dtype.newbyteorder("<").str
    description = {"descr": kind, "fortran_order": False, "shape": (rows, *like.shape[1:])}
    npy.write_array_header_1_0(buffer, description)
    return buffer.getvalue()
