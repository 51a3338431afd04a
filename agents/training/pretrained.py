"""Trained policies that come with the package: run folders with a policy and nothing else."""

from __future__ import annotations

import os
from pathlib import Path

from agents.errors import UserError, nearest

FOLDER = Path(__file__).parent.parent / "policies"
"""Holds a folder `ALGORITHM/TASK` for each policy."""


def pretrained(algorithm: str, task: str) -> Path:
    """Return the folder of a trained policy that comes with the package.

    `load_policy` and `circle2d render` take its name, "pretrained:ALGORITHM/TASK", as well.
    `config.json` in it tells how it was trained. Raises UserError, naming what there is, for an
    algorithm or task without one.
    """
    there = sorted(path.parent for path in FOLDER.glob("*/*/config.json"))
    algorithms = sorted({path.parent.name for path in there})
    if algorithm not in algorithms:
        hint = nearest(algorithm, algorithms)
        raise UserError(f"no policy of {algorithm!r} comes with the package: {hint}")
    tasks = [path.name for path in there if path.parent.name == algorithm]
    name = task.rpartition(":")[2]
    if name not in tasks:
        hint = nearest(name, tasks)
        raise UserError(f"no policy of {algorithm} for {task!r} comes with the package: {hint}")
    return FOLDER / algorithm / name


def folder_of(given: str | os.PathLike[str]) -> Path:
    """Return the folder given, for `pretrained:ALGORITHM/TASK` that of the package's policy."""
    kind, colon, name = Path(given).as_posix().partition(":")
    algorithm, _, task = name.partition("/")
    return pretrained(algorithm, task) if kind == "pretrained" and colon else Path(given)
