"""Versions and machine that trained some runs: numbers and speed may depend on them."""

from __future__ import annotations

import json
import os
import platform
import subprocess
from importlib.metadata import distribution, version
from pathlib import Path
from typing import Any

from agents.errors import UserError
from agents.training.checksums import write_files
from agents.training.files import json_bytes, read_json

PACKAGES = ("circle2d-mj", "gymnasium", "mujoco", "numpy", "torch")
CPUINFO = Path("/proc/cpuinfo")


def made_with() -> dict[str, Any]:
    """Versions and machine of this process, without times."""
    return {"versions": versions(), "machine": machine()}


def versions() -> dict[str, str]:
    """Python and the packages that results depend on."""
    return {"python": platform.python_version()} | {name: version(name) for name in PACKAGES}


def commit() -> str | None:
    """Commit of this code, "-dirty" behind it where files are changed: that of the checkout it lies
    in, or that pip installed it from; None for an installation from anything else."""
    root = Path(__file__).parents[2]
    if (root / ".git").exists():
        git = ("git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=40")
        try:
            done = subprocess.run(
                [*git, "--exclude=*"], capture_output=True, encoding="utf-8", check=True
            )
        except (OSError, subprocess.CalledProcessError):
            return None
        return done.stdout.strip()
    origin = json.loads(distribution("circle2d-mj").read_text("direct_url.json") or "{}")
    return origin.get("vcs_info", {}).get("commit_id")


def machine() -> dict[str, str | int]:
    """Processor and number of cores, without times."""
    return {"processor": _processor(), "cores": os.cpu_count() or 1}


def _processor() -> str:
    """The name that Linux gives, or else the platform's."""
    try:
        lines = CPUINFO.read_text(errors="replace").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return next(filter(None, names), platform.processor() or platform.machine())


def other_session(folder: Path) -> str:
    """Words on the versions and machine that trained a folder so far; empty where they are this
    process's own."""
    now, last = made_with(), sessions_of(read_json(folder / "config.json"))[-1]
    changed = [f"{name} {last[name]}" for name in now if last[name] != now[name]]
    if not changed:
        return ""
    return f"trained so far with other {' and '.join(changed)}: results may differ"


def note_session(folder: Path) -> None:
    """Record in a folder's configuration that this process goes on with its runs, where its
    versions or machine differ from the last ones."""
    now, path = made_with(), folder / "config.json"
    content = read_json(path)
    sessions = sessions_of(content)
    if sessions[-1] != now:
        changed = content | {"resumed": [*sessions[1:], now]}
        write_files(folder, {path.name: json_bytes(changed)})


def sessions_of(content: dict[str, Any]) -> list[dict[str, Any]]:
    """Versions and machine that began the runs of a configuration, then those that went on with
    them; None where not recorded."""
    resumed = content.get("resumed", [])
    if not isinstance(resumed, list) or not all(isinstance(of, dict) for of in resumed):
        raise UserError(
            f"config.json is damaged: resumed must be a list of objects, got {resumed!r}"
        )
    sessions = (content, *resumed)
    return [{name: of.get(name) for name in ("versions", "machine")} for of in sessions]
