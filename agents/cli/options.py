"""Options of the command line, which tyro reads from dataclasses, and checks of their values."""

from __future__ import annotations

import ast
import contextlib
import importlib
import io
import os
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass
from itertools import dropwhile, islice, takewhile
from pathlib import Path
from typing import Annotated, Any, TypeVar

import tyro

from agents.checks import In
from agents.errors import (
    OTHER_NAMES,
    OWN_ERRORS,
    HelpShown,
    OwnCodeError,
    UserError,
    described,
    is_missing,
)
from agents.reporting.table import LEAST_WIDTH

T = TypeVar("T")
Folder = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER")]
"""A folder, given before the options."""
Folders = Annotated[
    tuple[Path, ...],
    tyro.conf.Positional,
    tyro.conf.arg(metavar="FOLDER ...", help_behavior_hint="(required)"),
]
"""Several folders, given before the options."""
Imports = Annotated[
    tuple[str, ...],
    tyro.conf.UseAppendAction,
    tyro.conf.arg(
        name="import",
        metavar="MODULE",
        help="Python module to import first, from the current folder or installed, which registers "
        "algorithms (agents.register), tasks (gymnasium.register), measures or a study. May be "
        "repeated.",
    ),
]
"""The option `--import`, of every command that may use a user's own algorithms and tasks."""
Width = Annotated[
    int | None,
    In(LEAST_WIDTH),
    tyro.conf.arg(
        help="Characters per line for tables; by default the terminal's. To a file or pipe, tables "
        "are printed as Markdown unless a width is given."
    ),
]
"""The option `--width`, of every command that prints tables."""
Task = Annotated[str | None, tyro.conf.arg(help="Task of the runs, if a folder has several.")]
"""The option `--task`, of commands on the runs of one task."""
Size = Annotated[int, In(64, 4096), tyro.conf.arg(help="Pixels along each side of a picture.")]
"""The option `--size`, of commands that draw."""
MEANT = {f"--{a.replace('_', '-')}": f"--{b.replace('_', '-')}" for a, b in OTHER_NAMES.items()}
"""Options of other programs, and what they are called here."""


def parse(options: type[T], command: str, args: Sequence[str]) -> T:
    """Read the options of a command, importing the modules of `--import` first.

    Raises UserError, with a one-line message, for unknown, missing and invalid options.
    """
    import_modules(args)
    names = [arg.partition("=")[0].replace("_", "-") for arg in args]
    for name in _with_several_values(options):
        if names.count(name) > 1:  # only the last would count
            raise UserError(f"{name} is given twice: give all its values at once, as in {name} A B")
    message = io.StringIO()
    try:
        with contextlib.redirect_stderr(message), _REGISTRY:
            return tyro.cli(options, prog=f"circle2d {command}", args=list(args))
    except SystemExit as exit_:
        if not exit_.code:
            raise HelpShown(0) from None
        if not (words := message.getvalue()):  # `sys.exit` in a user's config: see `no_exit`
            raise
        meant = [f"{arg} is {MEANT[arg]} here" for arg in args if arg in MEANT]
        raise UserError("; ".join([_in_a_line(words), *meant])) from None


def _with_several_values(options: Any) -> list[str]:
    """Return the names of those options of a dataclass that take several values."""
    found: list[str] = []
    for field in fields(options):
        default = field.default if field.default_factory is MISSING else field.default_factory()
        if is_dataclass(default):
            found += _with_several_values(default)
        elif isinstance(default, (tuple, dict)):
            found.append("--" + field.name.replace("_", "-"))
    return found


def values_of(option: str, args: Sequence[str], most: int | None = None) -> list[str]:
    """Return the words after an option that must be known before all options are parsed.

    most: number of words that the option takes each time.
    """
    words: list[str] = []
    for place, arg in enumerate(args):
        name, equals, value = arg.partition("=")
        if name == option:
            behind = takewhile(lambda word: not word.startswith("--"), args[place + 1 :])
            words += [value] if equals else islice(behind, most)
    return words


def import_modules(args: Sequence[str]) -> None:
    """Import the modules that `--import` names, also from the current folder, from which nothing is
    imported without the option. Raises UserError if a module cannot be imported."""
    names = values_of("--import", args, most=1)
    if names and not {os.getcwd(), ""} & set(sys.path):
        sys.path.append(os.getcwd())  # after installed ones
    for name in names:
        if name.endswith(".py"):
            raise UserError(f"--import takes the name of a module: {name.removesuffix('.py')!r}")
        try:
            importlib.import_module(name)
        except OWN_ERRORS as error:  # raised by the user's own code
            if is_missing(error, name):
                raise UserError(f"--import: there is no module {name!r}") from error
            raise OwnCodeError(f"cannot import {name!r}: {described(error)}") from error


def _in_a_line(message: str) -> str:
    """Return the text of an error that tyro draws as a box, without title and hint to its help."""

    def is_rule(line: str) -> bool:
        return set(line) <= set("─- ") or line[0] in "╭╰+"

    lines = [line.strip("│| ") for line in message.splitlines()]
    boxed = dropwhile(lambda line: not is_rule(line), lines)  # a title may be above the box
    inside = [line for line in boxed if not is_rule(line)]
    words = takewhile(lambda line: not line.startswith(("For full help", "Argument help")), inside)
    told = re.sub(r"^Error parsing \w+: ", "", " ".join(words))  # has the name of our class
    return told or "the options cannot be understood"


def _integers(info: Any) -> Any:
    """Rule for tyro that accepts integers written as 1000000, 1_000_000 or 1e6."""
    if info.type is not int:
        return None
    return tyro.constructors.PrimitiveConstructorSpec(
        nargs=1,
        metavar="INT",
        instance_from_str=lambda strings: integer(strings[0]),
        is_instance=lambda value: isinstance(value, int),
        str_from_instance=lambda value: [str(value)],
    )


def integer(text: str) -> int:
    """Read an integer, which may be written as 1e6. Raises ValueError for any other text."""
    with contextlib.suppress(ValueError):
        return int(text)
    with contextlib.suppress(ValueError):
        if float(text).is_integer():
            return int(float(text))
    raise ValueError(f"must be an integer such as 1000000 or 1e6, got {text!r}")


_REGISTRY = tyro.constructors.ConstructorRegistry()
_REGISTRY.primitive_rule(_integers)


def check_suffix(path: Path, *allowed: str) -> None:
    """Raise UserError if a file to write has none of the suffixes, or cannot have a folder."""
    if path.suffix.lower() not in allowed:
        raise UserError(f"out must end in {' or '.join(allowed)}, got {str(path)!r}")
    for part in path.parents:
        if part.exists() and not part.is_dir():
            raise UserError(f"out must lie in a folder, but {str(part)!r} is a file")


def one_for_each(name: str, given: Sequence[T], folders: Iterable[Path]) -> Sequence[T | None]:
    """Return an option's value for each folder, or Nones if the option is not given. Raises
    UserError if the number of values differs from the number of folders."""
    count = len(list(folders))
    if given and len(given) != count:
        raise UserError(f"{name} must be one for each of the {count} folders, got {len(given)}")
    return given or [None] * count


def split_options(kind: type, args: Sequence[str]) -> tuple[list[str], dict[str, Any]]:
    """Separate a command's own options from those of algorithms; return words and values.

    Values are Python literals, or strings; several are a tuple. An option without a value is True,
    and --no-NAME sets NAME to False.
    """
    names = {"import" if field.name == "imports" else field.name for field in fields(kind)}
    known = {f"--{'no-' * no}{name.replace('_', '-')}" for name in names for no in (0, 1)} | {
        "--help"
    }
    own, others = [], {}
    words = own
    for arg in args:
        if arg.startswith("--"):
            name, equals, value = arg.partition("=")
            if name.replace("_", "-") in known:
                own.append(arg)
                words = own
                continue
            words = others.setdefault(name[2:].replace("-", "_"), [])
            words += [value] * bool(equals)
        else:
            words.append(arg)
    values: dict[str, Any] = {}
    for name, texts in others.items():
        found = tuple(literals(dict(enumerate(texts))).values())
        if not found and name.startswith("no_"):
            values[name.removeprefix("no_")] = False
        else:
            values[name] = (found[0] if len(found) == 1 else found) if found else True
    return own, values


def literals(given: Mapping[Any, str]) -> dict[Any, Any]:
    """Evaluate task parameters as Python literals (3.0, True, (1, 0.5)); keep any other text."""
    values: dict[Any, Any] = dict(given)
    for name, text in given.items():
        with contextlib.suppress(ValueError, SyntaxError, TypeError, MemoryError, RecursionError):
            values[name] = ast.literal_eval(text)
    return values
