"""Versions and machine that trained some runs: numbers and speed may depend on them."""

from __future__ import annotations

import json
import os
import platform
import subprocess
from importlib.metadata import distribution, version
from pathlib import Path
from typing import Any

PACKAGES = ("circle2d-mj", "gymnasium", "mujoco", "numpy", "torch")
CPUINFO = Path("/proc/cpuinfo")
LARGEST = 2**40
"""Bytes of memory where the system does not tell them."""


def made_with() -> dict[str, Any]:
    """Versions and machine of this process, without times."""
    versions = {"python": platform.python_version()} | {name: version(name) for name in PACKAGES}
    machine = {"processor": _processor(), "cores": os.cpu_count() or 1}
    return {"versions": versions, "machine": machine}


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


def cores() -> int:
    """Number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):  # not on macOS and Windows
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def machine_memory() -> int:
    """Bytes of the machine's memory."""
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):  # not on Windows
        return LARGEST


def _processor() -> str:
    """The name that Linux gives, or else the platform's."""
    try:
        lines = CPUINFO.read_text(errors="replace").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return next(filter(None, names), platform.processor() or platform.machine())
