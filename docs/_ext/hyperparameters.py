"""Tables of the algorithms' hyper-parameters, generated from their dataclasses."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import itertools
from textwrap import dedent

from agents.algorithms import ALGORITHMS
from agents.presets import preset


def tables() -> dict[str, str]:
    """Return tables of hyper-parameters in Markdown, by algorithm."""
    return {name: _table(name) for name in ALGORITHMS}


def _table(name: str) -> str:
    config = ALGORITHMS[name].config
    explained = {k: v for cls in reversed(config.__mro__[:-1]) for k, v in _texts(cls).items()}
    usual, on_task = config(), preset(name, "Circle2D-1-v0")
    lines = ["| option | default | on Circle2D | meaning |", "| --- | --- | --- | --- |"]
    for field in dataclasses.fields(config):
        default, here = (getattr(of, field.name) for of in (usual, on_task))
        option = f"`--{field.name.replace('_', '-')}`"
        other = "" if here == default else _words(here)
        lines.append(f"| {option} | {_words(default)} | {other} | {explained[field.name]} |")
    return "\n".join([*lines, ""])


def texts(cls: type) -> dict[str, str]:
    """Return by name the text below each field that the class itself, not a base, declares."""
    (definition,) = ast.parse(dedent(inspect.getsource(cls))).body
    return {
        ast.unparse(field.target): " ".join(ast.literal_eval(text.value).split())
        for field, text in itertools.pairwise(definition.body)
        if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr)
    }


def _texts(cls: type) -> dict[str, str]:
    return texts(cls) if dataclasses.is_dataclass(cls) else {}


def _words(value: object) -> str:
    """Return a value as typed on the command line."""
    return " ".join(map(str, value)) if isinstance(value, tuple) else str(value)
