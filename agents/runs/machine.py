"""What a training ran on, as far as it may matter to its numbers and its speed."""

from __future__ import annotations

import os
import platform
from pathlib import Path

CPUINFO = Path("/proc/cpuinfo")


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
