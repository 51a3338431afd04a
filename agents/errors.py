"""Mistakes of the user, and checks of the values they give."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable
from numbers import Real
from typing import Any


class UserError(ValueError):
    """A mistake of the user. The message names the thing, the value given, and those allowed.

    The command line prints it as one line and exits with status 2.
    """


class TaskFailure(UserError):
    """An environment that failed while it was stepped. The command line exits with status 1."""


def one_line(text: object) -> str:
    """Text for a terminal: one line, control characters written as escapes."""
    words = " ".join(str(text).splitlines())
    return "".join(
        letter if letter.isprintable() else letter.encode("unicode_escape").decode()
        for letter in words
    )


EXTRA = (
    "filelock",
    "jinja2",
    "matplotlib",
    "pandas",
    "rich",
    "scipy",
    "threadpoolctl",
    "torch",
    "tyro",
)
"""Packages that training and reports need, and that an installation without [train] lacks."""


def extra_hint(error: ModuleNotFoundError, user: str) -> str:
    """Return how to install the package of [train] that `user` lacks; "" for any other module."""
    if (error.name or "").partition(".")[0] not in EXTRA:
        return ""
    return f"{user} needs {error.name}, which is not installed: pip install 'circle2d-mj[train]'"


OTHER_NAMES = {
    "lr": "learning_rate",
    "gamma": "discount",
    "env": "task",
    "env_id": "task",
    "timesteps": "steps",
    "total_timesteps": "steps",
    "output": "out",
    "output_dir": "out",
}
"""Other libraries' names of options, and what they are here."""


def nearest(given: str, valid: Iterable[str], otherwise: str = "") -> str:
    """Return "did you mean 'x'?" for the most similar of the valid names.

    otherwise: what to return where none is similar, by default the list of the valid names.
    """
    names = {name.lower(): name for name in valid}  # "SAC-Lag" is near to "sac-lag"
    near = difflib.get_close_matches(given.lower(), names, n=1)
    if near:
        return f"did you mean {names[near[0]]!r}?"
    return otherwise or f"valid are {', '.join(names.values())}"


def check_integers(config: Any, *names: str, low: int, high: int = 2**40) -> None:
    """Refuse fields of a config that are not integers from `low` to `high`."""
    for name in names:
        value = getattr(config, name)
        if not isinstance(value, int) or isinstance(value, bool):
            raise UserError(f"{name} must be an integer, got {value!r}")
        if not low <= value <= high:
            rule = f"at least {low}" if value < low else f"at most {high}"
            raise UserError(f"{name} must be {rule}, got {value}")


def check(
    config: Any,
    *names: str,
    low: float = -math.inf,
    above: float = -math.inf,
    high: float = math.inf,
) -> None:
    """Refuse fields of a config that are not finite numbers within bounds (`above` is excluded)."""
    for name in names:
        value = getattr(config, name)
        if not _is_finite(value):
            raise UserError(f"{name} must be a finite number, got {value!r}")
        if not (low <= float(value) <= high and float(value) > above):
            bounds = {"at least": low, "above": above, "at most": high}
            rule = " and ".join(f"{k} {v:g}" for k, v in bounds.items() if math.isfinite(v))
            raise UserError(f"{name} must be {rule}, got {value!r}")


def check_scale(config: Any) -> None:
    """Refuse an `input_scale` that is neither a number from 1e-6 to 1e6 nor a tuple of them."""
    value = config.input_scale
    factors = value if isinstance(value, tuple) else (value,)
    if not all(_is_finite(factor) and 1e-6 <= factor <= 1e6 for factor in factors) or not factors:
        raise UserError(
            "input_scale must be a number from 1e-06 to 1e+06, or one for each number of an "
            f"observation, got {value!r}"
        )


def _is_finite(value: Any) -> bool:
    """Whether a value is a real number that a float can hold."""
    try:
        return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:  # an integer beyond all floats
        return False


def check_choice(config: Any, name: str, *allowed: str) -> None:
    """Refuse a field of a config that is not one of the allowed words."""
    if getattr(config, name) not in allowed:
        given = getattr(config, name)
        raise UserError(f"{name} must be {' or '.join(allowed)}, got {given!r}")
