"""Progress, speed and time of trainings: `status.json` in their folders.

Results hold no times; this file does, and nothing that is computed depends on it.
"""

from __future__ import annotations

import secrets
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from agents.errors import UserError
from agents.lockstep.compiling import CLOCK
from agents.training.files import read_json, write_json

STATUS = "status.json"
"""In the folder of the runs. {"share": in [0, 1], "steps_per_second": a number or null, "sessions":
{"random id of a process": seconds}}."""
EVERY_SECONDS = 1.0
"""Least time between two writes."""


class Measured(Protocol):
    """A training as it is measured: `Training`."""

    steps: NDArray[np.int64]
    """Environment steps each run has taken, [R]."""
    failed: NDArray[np.bool_]
    """[R]"""

    @property
    def done(self) -> bool: ...


class Reading(NamedTuple):
    """Progress of trainings that run together, at one time."""

    seconds: float
    """Since the measuring began."""
    steps: int
    """Environment steps of the run that has taken the fewest, those that failed apart."""
    share: float
    """Done, in [0, 1]."""
    steps_per_second: float | None
    """Of all runs together, since the first epoch; None as long as there is no other."""
    seconds_left: float | None
    """None likewise."""


class Meter:
    """Measures trainings after each of their epochs.

    The first epoch of a process is not counted in its speed, since it pays for what is done only
    once, nor is the time in which the compiler works.
    """

    def __init__(self, steps: int) -> None:
        """steps: of each run in all."""
        self._steps, self._started = steps, time.monotonic()
        self._first: tuple[float, int, float] | None = None

    def read(self, trainings: Sequence[Measured]) -> Reading:
        """Progress of the trainings, all that run together."""
        now = time.monotonic()
        taken = np.concatenate([training.steps for training in trainings])
        failed = np.concatenate([training.failed for training in trainings])
        steps, total = int(taken[~failed].min(initial=self._steps)), int(taken.sum())
        share, working = min(1.0, steps / self._steps), now - CLOCK.seconds
        self._first = self._first or (working, total, share)
        seconds, more, gained = working - self._first[0], total - self._first[1], share
        gained -= self._first[2]
        known = seconds > 0 and gained > 0
        speed = more / seconds if known else None
        left = seconds * (1 - share) / gained if known else None
        return Reading(now - self._started, steps, share, speed, left)


class StatusFiles:
    """Keeps `status.json` of folders that one process trains together."""

    def __init__(self, folders: Sequence[Path], steps: int) -> None:
        """steps: of each run in all."""
        self._folders, self._meter = folders, Meter(steps)
        self._session, self._written = secrets.token_hex(8), -float("inf")
        read = {folder: _read(folder) for folder in folders}
        self._before = {
            folder: status.sessions if status else {} for folder, status in read.items()
        }

    def update(self, trainings: Sequence[Measured], last: bool = False) -> None:
        """Write where that is due: once a second, and where `last` says so."""
        if not last and time.monotonic() - self._written < EVERY_SECONDS:
            return
        self._written = time.monotonic()
        now = self._meter.read(trainings)
        for folder in self._folders:
            sessions = self._before[folder] | {self._session: round(now.seconds, 3)}
            content = {"share": now.share, "steps_per_second": now.steps_per_second}
            write_json(folder / STATUS, content | {"sessions": sessions})


class _Status(NamedTuple):
    """The content of `status.json`."""

    share: float
    steps_per_second: float | None
    sessions: dict[str, float]


def share_done(folder: Path) -> float:
    """Share of the training of a folder that is done, in [0, 1]; 0 where nothing says."""
    status = _read(folder)
    return status.share if status else 0.0


def speed(folder: Path) -> float | None:
    """Environment steps a second of the training of a folder, all runs that train together; None
    where nothing says."""
    status = _read(folder)
    return status.steps_per_second if status else None


def sessions(folder: Path) -> dict[str, float]:
    """Seconds that each process trained a folder, by its random id; empty where nothing says.

    What a killed process did after its last write is not counted.
    """
    status = _read(folder)
    return status.sessions if status else {}


def duration(seconds: float) -> str:
    """Seconds in words: 3 h 2 min, 5 min, 40 s."""
    minutes = round(seconds / 60)
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{minutes // 60} h {minutes % 60} min" if minutes >= 60 else f"{minutes} min"


def _read(folder: Path) -> _Status | None:
    """None where the file is missing, damaged or of another form: no result depends on it."""
    try:
        content = read_json(folder / STATUS)
    except UserError:
        return None
    share: Any = content.get("share")
    per_second: Any = content.get("steps_per_second")
    sessions: Any = content.get("sessions")
    valid = _is_number(share, 1.0) and (per_second is None or _is_number(per_second))
    if not valid or not isinstance(sessions, dict) or not all(map(_is_number, sessions.values())):
        return None
    return _Status(share, per_second, sessions)


def _is_number(value: Any, most: float = 1e300) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and 0 <= value <= most
