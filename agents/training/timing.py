"""How far trainings are and how long they took, by the `timing.log` that `show_progress` writes."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

Session = tuple[str, ...]
"""The lines that one process wrote."""


def share_done(folder: Path) -> float:
    """How far the training of a folder last was, in [0, 1]; 0 where its log does not say."""
    told = _last(folder, r" (\d+) % after ")
    return int(told) / 100 if told else 0.0


def speed(folder: Path) -> float | None:
    """Environment steps a second of the training of a folder, all runs of its group together; None
    where its log does not say."""
    told = _last(folder, r" s, ([\d,]+) steps/s$")
    return float(told.replace(",", "")) if told else None


def duration(seconds: float) -> str:
    """As a person says it: 3 h 2 min, 5 min, 40 s."""
    minutes = round(seconds / 60)
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{minutes // 60} h {minutes % 60} min" if minutes >= 60 else f"{minutes} min"


def _last(folder: Path, pattern: str) -> str | None:
    """What the pattern's group was in the last line that it fits."""
    found = (re.search(pattern, line) for line in reversed(_lines(folder)))
    return next((match[1] for match in found if match), None)


def _lines(folder: Path) -> list[str]:
    try:
        return (folder / "timing.log").read_text(errors="replace").splitlines()
    except OSError:
        return []


def seconds_trained(folders: Iterable[Path]) -> int | None:
    """Wall time of all the processes that trained some folders, added up, in seconds.

    A process that trained several folders left the same lines in each, and counts once. What a
    killed process did after its last line is not counted. None where no folder has a log.
    """
    sessions = {session for folder in folders for session in _sessions(folder)}
    return sum(map(_seconds, sessions)) if sessions else None


def _sessions(folder: Path) -> list[Session]:
    """A process begins where the seconds begin anew."""
    sessions: list[list[str]] = []
    for line in filter(_after, _lines(folder)):
        if not sessions or _seconds(sessions[-1]) > _seconds([line]):
            sessions.append([])
        sessions[-1].append(line)
    return [tuple(session) for session in sessions]


def _seconds(lines: Iterable[str]) -> int:
    *_, last = lines
    found = _after(last)
    assert found
    return int(found[1])


def _after(line: str) -> re.Match[str] | None:
    return re.search(r" % after (\d+) s\b", line)
