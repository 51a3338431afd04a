"""How long trainings took, by the `timing.log` that `show_progress` writes."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

Session = tuple[str, ...]
"""The lines that one process wrote."""


def seconds_trained(folders: Iterable[Path]) -> int | None:
    """Wall time of all the processes that trained some folders, added up, in seconds.

    A process that trained several folders left the same lines in each, and counts once. What a
    killed process did after its last line is not counted. None where no folder has a log.
    """
    sessions = {session for folder in folders for session in _sessions(folder)}
    return sum(map(_seconds, sessions)) if sessions else None


def _sessions(folder: Path) -> list[Session]:
    """A process begins where the seconds begin anew."""
    try:
        lines = (folder / "timing.log").read_text(errors="replace").splitlines()
    except OSError:
        return []
    sessions: list[list[str]] = []
    for line in (line for line in lines if _after(line)):
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
