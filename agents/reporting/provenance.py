"""Provenance of the numbers of a report: commands, versions, machines, time."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import version
from typing import Any

from agents.algorithms import BUILT_IN, title
from agents.results.frame import hyperparameter_changes, in_order, title_of
from agents.results.reading import Group
from agents.training.config import TrainConfig
from agents.training.machine import commit, sessions_of
from agents.training.status import duration


def made(groups: Sequence[Group]) -> dict[str, str]:
    """All that is needed to make the numbers again, by name.

    program: this one, with its commit; command: a line for each folder. Versions, machine and
    training time are those that the run folders hold, and left out where there are none.
    """
    groups = [part for group in groups for part in group.parts]
    sessions = [session for group in groups for session in sessions_of(dict(group.recorded))]
    versions = {
        f"{name} {version}"
        for session in sessions
        for name, version in (session["versions"] or {}).items()
    }
    machines = {
        f"{session['machine']['processor']}, {session['machine']['cores']} cores"
        for session in sessions
        if session["machine"]
    }
    facts = {
        "program": program(),
        "command": "\n".join(
            command(group.config, group.task, group.title, group.recorded) for group in groups
        ),
        "versions": ", ".join(sorted(versions)),
        "machine": "; ".join(sorted(machines)),
        "training time": _training_time([group.sessions() for group in groups]),
        "runs": str(sum(len(group.runs) for group in groups)),
        "seeds": _list(seed for group in groups for seed in group.config.seeds),
        "steps": _list(group.config.steps for group in groups),
    }
    return {name: text for name, text in facts.items() if text}


def program() -> str:
    """Name, version and, where it is known, commit."""
    words = f"circle2d-mj {version('circle2d-mj')}"
    return f"{words}, commit {known}" if (known := commit()) else words


def common_name(groups: Sequence[Group]) -> str:
    """The name of the folder that holds all groups: the first part of every title."""
    return groups[0].title.partition(" + ")[0].partition("/")[0]


def heading(groups: Sequence[Group]) -> str:
    """A title that names the runs: their algorithms and tasks."""
    names = list(dict.fromkeys(title(group.config.algorithm) for group in in_order(groups)))
    tasks = list(dict.fromkeys(group.task for group in groups))
    return f"{_few(names, 'algorithms')} on {_few(tasks, 'tasks')}"


def summary(groups: Sequence[Group]) -> str:
    """One line on the runs: how many, on how many tasks, for how long."""
    configs = [group.config for group in groups]
    names = {config.algorithm for config in configs}
    settings = {title_of(group.config, group.task) for group in groups}
    parts = [
        _count(sum(len(group.runs) for group in groups), "run"),
        _count(len({group.task for group in groups}), "task"),
        _count(len(names), "algorithm"),
        *([f"{len(settings)} settings"] if len(settings) > len(names) else []),
        f"seeds {_seeds({seed for config in configs for seed in config.seeds})}",
        f"{' or '.join(f'{n:,}' for n in sorted({c.steps for c in configs}))} steps each",
    ]
    return ", ".join(parts)


def _seeds(seeds: set[int]) -> str:
    """Numbers as a list, or as a range where there are no gaps."""
    low, high = min(seeds), max(seeds)
    return f"{low} to {high}" if len(seeds) == high - low + 1 > 3 else _list(seeds)


def _few(names: Sequence[str], many: str) -> str:
    """Up to five names; more are counted."""
    if len(names) > 5:
        return f"{len(names)} {many}"
    *others, last = names
    return f"{', '.join(others)} and {last}" if others else last


def _count(number: int, name: str) -> str:
    return f"{number:,} {name}{'s' * (number != 1)}"


def command(config: TrainConfig, task: str, out: str, recorded: Mapping[str, Any]) -> str:
    """The command that trains some runs, with everything that decides their numbers.

    recorded: their `config.json`, which has the modules that register algorithm and task.
    """
    modules = [] if config.algorithm in BUILT_IN else [recorded.get("algorithm_module")]
    modules += [] if ":" in task else [recorded.get("task_module")]
    imports = [f"--import {m}" for m in dict.fromkeys(modules) if m and m != "__main__"]
    options = {"algorithm": config.algorithm, "task": task, "seeds": config.seeds}
    options |= {"steps": config.steps} | hyperparameter_changes(config, task)
    if config.task_parameters:
        pairs = (part for pair in config.task_parameters.items() for part in pair)
        options["task_parameters"] = tuple(pairs)
    options |= {"backend": config.backend}  # without it the machine decides
    for name, usual in (("vectorization", "auto"), ("device", "cpu")):
        if getattr(config, name) != usual:
            options[name] = getattr(config, name)
    typed = (f"--{k.replace('_', '-')} {_typed(v)}" for k, v in (options | {"out": out}).items())
    return " ".join(["circle2d train", *imports, *typed])


def _training_time(sessions: Sequence[Mapping[str, float]]) -> str:
    """Time of all processes that trained. One that trained several folders counts once."""
    timed = [folder for folder in sessions if folder]
    if not timed:
        return ""
    seconds = {process: took for folder in timed for process, took in folder.items()}
    few = "" if len(timed) == len(sessions) else f", of {len(timed)} of {len(sessions)} folders"
    return f"{duration(sum(seconds.values()))}, all processes together{few}"


def _typed(value: Any) -> str:
    return " ".join(map(_quoted, value)) if isinstance(value, tuple) else _quoted(value)


def _quoted(value: Any) -> str:
    return shlex.quote(str(value))


def _list(numbers: Iterable[int]) -> str:
    return ", ".join(f"{number:,}" for number in sorted(set(numbers)))
