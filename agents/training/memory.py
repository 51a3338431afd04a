"""Memory that a training takes, told before anything is written."""

from __future__ import annotations

import os
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from agents.errors import UserError

NETS, COPIES, NUMBER = 5, 4, 4
"""Networks of a run, copies of each (moments and targets among them) and bytes of a number. Not
exact: what is refused is larger than the machine by far or by little."""
LARGEST = 2**40
"""Bytes at most where the system does not tell its memory."""


def check_memory(hyperparameters: Any, runs: int, sizes: Sequence[int]) -> None:
    """Raise UserError, naming the hyper-parameter, where runs need more than the machine's memory.

    sizes: numbers that an observation and an action hold.
    """
    observation, action = sizes
    needed = {}
    if (capacity := getattr(hyperparameters, "replay_size", None)) is not None:
        needed["replay_size"] = runs * capacity * (2 * observation + action + 3) * NUMBER
    if hidden := getattr(hyperparameters, "hidden", ()):
        widths = (observation + action, *hidden, 2 * action)
        parameters = sum((a + 1) * b for a, b in pairwise(widths))
        needed["hidden"] = runs * parameters * NETS * COPIES * NUMBER
        if (batch := getattr(hyperparameters, "batch_size", None)) is not None:
            needed["batch_size"] = runs * batch * sum(hidden) * NETS * NUMBER
    there = machine_memory()
    for name, size in needed.items():
        if size > there:
            raise UserError(
                f"{name} {getattr(hyperparameters, name)} needs about {_gigabytes(size)} of memory "
                f"for {runs} {'run' if runs == 1 else 'runs'}; this machine has {_gigabytes(there)}"
            )


def machine_memory() -> int:
    """Bytes of the machine's memory."""
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):  # not on Windows
        return LARGEST


def _gigabytes(size: int) -> str:
    return f"{size / 1e9:,.1f} GB"
