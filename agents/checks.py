"""Dataclasses of settings whose fields declare the values allowed, and their checks."""

from __future__ import annotations

import dataclasses
import functools
import math
import types
from numbers import Real
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from agents.errors import UserError

MOST = 2**40
"""Largest integer, unless a field declares another bound."""
TOO_LARGE = f"at most {MOST}"


@dataclasses.dataclass(frozen=True)
class In:
    """The numbers that a field allows, as in `Annotated[float, In(0, 1)]`; `above` is excluded."""

    low: float = -math.inf
    high: float = math.inf
    above: float = -math.inf

    def __str__(self) -> str:
        ends = {"at least": self.low, "above": self.above, "at most": self.high}
        return " and ".join(f"{k} {v:g}" for k, v in ends.items() if math.isfinite(v))

    def __contains__(self, value: float) -> bool:
        return self.low <= float(value) <= self.high and float(value) > self.above


class Settings:
    """Base of a frozen dataclass whose values are checked against the types of its fields.

    It checks numbers (with the bounds of `In`, if the annotation has it), bool, Literal, tuples of
    numbers, and unions of these. NumPy's numbers become Python's, and whole floats, such as 1e6 on
    the command line, become integers where the type is int. A class with rules between fields adds
    them to `__post_init__`.
    """

    def __post_init__(self) -> None:
        """Check the values. Raises UserError naming the field, the value, and what is allowed."""
        for name, value in list(vars(self).items()):
            object.__setattr__(self, name, _plain(value))
        for name, hint in _hints(type(self)).items():
            object.__setattr__(self, name, as_integer(getattr(self, name), hint))
            check(name, getattr(self, name), hint)


def as_integer(value: Any, hint: Any = int) -> Any:
    """Return a whole float, such as 1e6, as an integer if the type is int; any other value as it
    is."""
    kinds = get_args(hint) if get_origin(hint) in (Union, types.UnionType) else (hint,)
    kinds = [get_args(k)[0] if get_origin(k) is Annotated else k for k in kinds]
    asked = int in kinds and float not in kinds
    return int(value) if asked and isinstance(value, float) and value.is_integer() else value


def check(name: str, value: Any, hint: Any) -> None:
    """Raise UserError naming an argument, its value and what is allowed, if it is not allowed."""
    if problem := _problem(_plain(value), hint):
        raise UserError(f"{name} must be {problem}, got {value!r}")


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return tuple(map(_plain, value))
    if isinstance(value, dict):
        return {name: _plain(one) for name, one in value.items()}
    return value.item() if isinstance(value, np.generic) else value


@functools.cache
def _hints(cls: type) -> dict[str, Any]:
    try:
        hints = get_type_hints(cls, include_extras=True)
    except NameError:  # a local class may use names that its module lacks
        return {}
    return {field.name: hints[field.name] for field in dataclasses.fields(cls)}  # pyright: ignore


def _problem(value: Any, hint: Any, bounds: In | None = None) -> str:
    """Return what a value must be, in words; "" if the value is allowed."""
    if get_origin(hint) is Annotated:
        hint, *marks = get_args(hint)
        bounds = next((mark for mark in marks if isinstance(mark, In)), bounds)
    arguments = get_args(hint)
    if get_origin(hint) in (Union, types.UnionType):
        problems = [_problem(value, kind, bounds) for kind in arguments]
        return "" if "" in problems else " or ".join(dict.fromkeys(problems))
    if hint is type(None):
        return "" if value is None else "None"
    if get_origin(hint) is Literal:
        return "" if value in arguments else " or ".join(map(str, arguments))
    if hint is bool:
        return "" if isinstance(value, bool) else "True or False"
    if hint in (int, float):
        return _no_number(value, hint, bounds or In())
    if get_origin(hint) is tuple and arguments[1:] == (...,) and arguments[0] in (int, float):
        each = "integers" if arguments[0] is int else "numbers"
        rule = f", each {bounds}" if bounds else ""
        if isinstance(value, tuple) and value:
            problems = {_problem(part, arguments[0], bounds) for part in value} - {""}
            if not problems:
                return ""
            rule = f", each {TOO_LARGE}" if TOO_LARGE in problems else rule
        return f"a tuple of one or more {each}{rule}"
    return ""


def _no_number(value: Any, kind: type, bounds: In) -> str:
    kinds: Any = int if kind is int else Real  # Real has no comparisons for type checkers
    if isinstance(value, bool) or not isinstance(value, kinds):
        return "an integer" if kind is int else "a finite number"
    try:
        finite = math.isfinite(value)
    except OverflowError:  # an integer larger than any float
        finite = False
    if not finite:
        return "a finite number"
    if kind is int and bounds.high == math.inf and value > MOST:
        return TOO_LARGE
    return "" if value in bounds else str(bounds)
