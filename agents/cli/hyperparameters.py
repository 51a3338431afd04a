"""Every hyper-parameter of every algorithm in words: meaning, default, source."""

from __future__ import annotations

import ast
import inspect
import itertools
from collections.abc import Iterator
from dataclasses import fields
from textwrap import dedent, fill
from typing import Any

from agents.algorithms import ALGORITHMS
from agents.paper.presets import preset


def explain_all(task: str) -> str:
    """The options of all algorithms, those that several share only once.

    task: whose presets are shown where they differ from the defaults.
    """
    sharing: dict[type, list[str]] = {}
    for name, algorithm in ALGORITHMS.items():
        declaring = (_declaring(algorithm.config, field.name) for field in fields(algorithm.config))
        for cls in dict.fromkeys(declaring):
            sharing.setdefault(cls, []).append(name)
    sections = [
        "\n".join([f"Hyper-parameters of {', '.join(names)}:", *_entries(cls, names, task)])
        for cls, names in sharing.items()
    ]
    return "\n\n".join(sections) + "\n"


def _entries(cls: type, names: list[str], task: str) -> Iterator[str]:
    configs = [preset(name, task) for name in names]
    for name, text in texts(cls).items():
        default = getattr(ALGORITHMS[names[0]].config(), name)
        own = [config for config in configs if _declaring(type(config), name) is cls]
        chosen = dict.fromkeys(getattr(config, name) for config in own)
        on_task = " or ".join(map(_typed, chosen))
        other = f"; {on_task} on {task}" if on_task != _typed(default) else ""
        entry = f"--{name.replace('_', '-')} ({_typed(default)}{other}): {text}"
        yield fill(
            entry,
            96,
            initial_indent="  ",
            subsequent_indent="      ",
            break_on_hyphens=False,
        )


def _typed(value: Any) -> str:
    """As one types it."""
    return " ".join(map(str, value)) if isinstance(value, tuple) else str(value)


def _declaring(config: type, field: str) -> type:
    """The class that says what a field is for this config: the first that declares it."""
    return next(cls for cls in config.__mro__ if field in vars(cls).get("__annotations__", {}))


def texts(cls: type) -> dict[str, str]:
    """The text below each field that a dataclass itself declares, by name."""
    (definition,) = ast.parse(dedent(inspect.getsource(cls))).body
    assert isinstance(definition, ast.ClassDef)
    pairs = itertools.pairwise(definition.body)
    return {
        ast.unparse(field.target): " ".join(ast.literal_eval(text.value).split())
        for field, text in pairs
        if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr)
    }
