"""How the numbers of a report came about: commands, versions, machines, time."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from agents.errors import UserError
from agents.reporting.tables import hyperparameter_changes
from agents.results.reading import Group
from agents.training.config import TrainConfig
from agents.training.files import read_json
from agents.training.machine import sessions_of
from agents.training.status import duration, seconds_trained


def made(folder: Path, groups: Sequence[Group]) -> dict[str, str]:
    """What a reader has to know to make the numbers again, by name.

    folder: the report's. Versions and machine are those that the run folders hold; the time is that
    of their `status.json`, and left out where there is none.
    """
    sessions = [of for group in groups for of in sessions_of(_content(group.folder))]
    versions = {
        f"{name} {version}" for of in sessions for name, version in (of["versions"] or {}).items()
    }
    machines = {
        f"{of['machine']['processor']}, {of['machine']['cores']} cores"
        for of in sessions
        if of["machine"]
    }
    told = {
        "command": "\n".join(
            command(group.config, _name(folder, group.folder)) for group in groups
        ),
        "versions": ", ".join(sorted(versions)),
        "machine": "; ".join(sorted(machines)),
        "training time": _training_time([group.folder for group in groups]),
        "runs": str(sum(len(group.runs) for group in groups)),
        "seeds": _list(seed for group in groups for seed in group.config.seeds),
        "steps": _list(group.config.steps for group in groups),
    }
    return {name: text for name, text in told.items() if text}


def command(config: TrainConfig, out: str) -> str:
    """The command that trains some runs, with everything that decides their numbers."""
    options = {"algorithm": config.algorithm, "task": config.task, "seeds": config.seeds}
    options |= {"steps": config.steps} | hyperparameter_changes(config)
    if config.task_parameters:
        pairs = (part for pair in config.task_parameters.items() for part in pair)
        options["task_parameters"] = tuple(pairs)
    options |= {"backend": config.backend}  # without it the machine decides
    for name, usual in (("vectorization", "auto"), ("device", "cpu")):
        if getattr(config, name) != usual:
            options[name] = getattr(config, name)
    typed = (f"--{k.replace('_', '-')} {_typed(v)}" for k, v in (options | {"out": out}).items())
    return " ".join(["circle2d train", *typed])


def _training_time(folders: Sequence[Path]) -> str:
    logged = [folder for folder in folders if seconds_trained([folder]) is not None]
    seconds = seconds_trained(logged)
    if seconds is None:
        return ""
    of = "" if logged == folders else f", of {len(logged)} of {len(folders)} folders"
    return f"{duration(seconds)}, all processes together{of}"


def _content(folder: Path) -> dict[str, Any]:
    try:
        return read_json(folder / "config.json")
    except UserError:
        return {}


def _name(folder: Path, of: Path) -> str:
    """A folder of runs as seen from beside the report's."""
    return str(Path(folder.resolve().name) / of.relative_to(folder))


def _typed(value: Any) -> str:
    return " ".join(map(_quoted, value)) if isinstance(value, tuple) else _quoted(value)


def _quoted(value: Any) -> str:
    return shlex.quote(str(value))


def _list(numbers: Iterable[int]) -> str:
    return ", ".join(f"{number:,}" for number in sorted(set(numbers)))
