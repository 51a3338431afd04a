"""What trained some runs, as far as it may matter to their numbers and their speed."""

from __future__ import annotations

import os
import platform
from importlib.metadata import version
from pathlib import Path
from typing import Any

from agents.training.files import read_json, write_json

PACKAGES = ("circle2d-mj", "gymnasium", "mujoco", "numpy", "torch")
CPUINFO = Path("/proc/cpuinfo")


def made_with() -> dict[str, Any]:
    """Versions and machine of this process: always the same for the same, no times."""
    return {"versions": versions(), "machine": machine()}


def versions() -> dict[str, str]:
    """Python and the packages that results depend on."""
    return {"python": platform.python_version()} | {name: version(name) for name in PACKAGES}


def machine() -> dict[str, str | int]:
    """Processor and number of cores: always the same on the same machine, no times."""
    return {"processor": _processor(), "cores": os.cpu_count() or 1}


def _processor() -> str:
    """The name that Linux gives; elsewhere, and where it gives none, the platform's."""
    try:
        lines = CPUINFO.read_text(errors="replace").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return next(filter(None, names), platform.processor() or platform.machine())


def other_session(folder: Path) -> str:
    """In words, what trained the runs of a folder so far, where that is not this process's versions
    and machine; nothing where it is."""
    now, last = made_with(), sessions_of(read_json(folder / "config.json"))[-1]
    changed = [f"{name} {last[name]}" for name in now if last[name] != now[name]]
    if not changed:
        return ""
    return f"trained so far with other {' and '.join(changed)}: results may differ"


def note_session(folder: Path) -> None:
    """Record in a folder's configuration that this process goes on with its runs, where its
    versions and machine are not what they were trained with last."""
    now, path = made_with(), folder / "config.json"
    content = read_json(path)
    sessions = sessions_of(content)
    if sessions[-1] != now:
        write_json(path, content | {"resumed": [*sessions[1:], now]})


def sessions_of(content: dict[str, Any]) -> list[dict[str, Any]]:
    """Versions and machine that began the runs of a configuration, then those that went on with
    them; None for what was not recorded."""
    sessions = (content, *content.get("resumed", []))
    return [{name: of.get(name) for name in ("versions", "machine")} for of in sessions]
