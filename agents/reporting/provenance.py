"""Provenance of a report's numbers: commands, versions, machines, time."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import version
from typing import Any

from agents.algorithms import title
from agents.results.groups import Group
from agents.results.names import hyperparameter_changes, in_order
from agents.training.callbacks import duration
from agents.training.callbacks import sessions as sessions_of
from agents.training.config import TrainConfig, commit


def made(groups: Sequence[Group]) -> dict[str, str]:
    """Return everything needed to reproduce the numbers, by name.

    program: this package with its commit; command: a line for each folder. Versions, machine and
    training time are read from the run folders, and left out if these have none.
    """
    folders = [*{own.folder: own for group in groups for own in group.trainings}.values()]
    by_part = [sessions_of(own.path) for own in folders]
    sessions = {name: one for each in by_part for name, one in each.items()}
    versions = {
        f"{name} {number}"
        for session in sessions.values()
        for name, number in (session.get("versions") or {}).items()
    }
    machines = {
        f"{session['machine']['processor']}, {session['machine']['cores']} cores"
        for session in sessions.values()
        if session.get("machine")
    }
    timed = sum(map(bool, by_part))
    few = "" if timed == len(folders) else f", of {timed} of {len(folders)} folders"
    seconds = sum(float(session.get("seconds") or 0.0) for session in sessions.values())
    facts = {
        "program": program(),
        "command": "\n".join(command(p.config, p.title, p.recorded) for p in folders),
        "versions": ", ".join(sorted(versions)),
        "machine": "; ".join(sorted(machines)),
        "training time": f"{duration(seconds)}, all processes together{few}" if timed else "",
        "runs": str(_runs(groups)),
        "seeds": _list(seed for group in groups for seed in group.config.seeds),
        "steps": _list(group.total_steps for group in groups),
    }
    return {name: text for name, text in facts.items() if text}


def program() -> str:
    """Return the package's name, version and, if known, commit."""
    words = f"circle2d-mj {version('circle2d-mj')}"
    return f"{words}, commit {known}" if (known := commit()) else words


def heading(groups: Sequence[Group]) -> str:
    """Return a title that names the runs' algorithms and tasks."""
    names = list(dict.fromkeys(title(group.config.algorithm) for group in in_order(groups)))
    tasks = list(dict.fromkeys(group.task for group in groups))
    return f"{_few(names, 'algorithms')} on {_few(tasks, 'tasks')}"


def _runs(groups: Sequence[Group]) -> int:
    """Count the runs once each, although a run is in a group for each of its costs."""
    return sum(len(group.runs) for group in groups if group.is_of_first_cost)


def summary(groups: Sequence[Group]) -> str:
    """Return one line on the runs: how many, on how many tasks, for how long."""
    configs = [group.config for group in groups]
    names = {config.algorithm for config in configs}
    settings, lengths = {group.variant for group in groups}, {group.total_steps for group in groups}
    parts = [
        _count(_runs(groups), "run"),
        _count(len({group.task for group in groups}), "task"),
        _count(len(names), "algorithm"),
        *([f"{len(settings)} settings"] if len(settings) > len(names) else []),
        f"seeds {_seeds({seed for config in configs for seed in config.seeds})}",
        f"{' or '.join(f'{n:,}' for n in sorted(lengths))} steps each",
    ]
    return ", ".join(parts)


def _seeds(seeds: set[int]) -> str:
    """Return seeds as a list, or as a range if they have no gaps."""
    low, high = min(seeds), max(seeds)
    return f"{low} to {high}" if len(seeds) == high - low + 1 > 3 else _list(seeds)


def _few(names: Sequence[str], many: str) -> str:
    """List up to five names; count more."""
    if len(names) > 5:
        return f"{len(names)} {many}"
    *others, last = names
    return f"{', '.join(others)} and {last}" if others else last


def _count(number: int, name: str) -> str:
    return f"{number:,} {name}{'s' * (number != 1)}"


def command(config: TrainConfig, out: str, recorded: Mapping[str, Any]) -> str:
    """Return the command that trains the runs again, with everything that determines their numbers.

    recorded: content of their `config.json`, with the modules that register algorithm and tasks.
    """
    modules = [name for name in recorded.get("modules") or () if name != "__main__"]
    modules = [name for name in modules if not name.startswith("agents.")]  # built in
    modules = [name for name in modules if not any(t.startswith(f"{name}:") for t in config.tasks)]
    imports = [f"--import {name}" for name in modules]
    options: dict[str, Any] = {"task": config.tasks, "seeds": config.seeds, "steps": config.steps}
    options |= hyperparameter_changes(config, config.tasks[0])
    if config.task_parameters:
        pairs = (part for pair in config.task_parameters.items() for part in pair)
        options["task_parameters"] = tuple(pairs)
    for name in ("costs", "vectorization", "backend", "evaluation_episodes"):
        if (value := getattr(config, name)) != getattr(TrainConfig, name):
            options[name] = value
    typed = (_typed(name, value) for name, value in (options | {"out": out}).items())
    return " ".join(["circle2d train", config.algorithm, *imports, *typed])


def _typed(name: str, value: Any) -> str:
    """Return an option as typed in a shell; bools are flags."""
    option = name.replace("_", "-")
    if isinstance(value, bool):
        return f"--{option}" if value else f"--no-{option}"
    return f"--{option} {shlex.join(map(str, value if isinstance(value, tuple) else (value,)))}"


def _list(numbers: Iterable[int]) -> str:
    return ", ".join(f"{number:,}" for number in sorted(set(numbers)))
