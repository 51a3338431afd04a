"""Options of the command line, as tyro reads them from dataclasses."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import importlib
import io
import re
import traceback
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, get_type_hints

import tyro

from agents.errors import UserError, nearest

BackendChoice = Literal["auto", "compiled", "eager"]
Imports = Annotated[
    tuple[str, ...],
    tyro.conf.UseAppendAction,
    tyro.conf.arg(
        name="import",
        metavar="MODULE",
        help="Python module to import first, from the current folder or installed, which registers "
        "algorithms (agents.register), tasks (gymnasium.register) or measures. May be repeated.",
    ),
]
"""The option `--import`, of every command that may meet a user's own algorithms and tasks."""


def parse(
    options: type, command: str, args: Sequence[str], elsewhere: Mapping[str, str] | None = None
) -> Any:
    """Read the options of a command, importing the modules of `--import` first.

    elsewhere: options that the command has in other cases, by name, and in which.
    Raises UserError, in one line, for unknown, missing and invalid options.
    """
    if "imports" in {field.name for field in dataclasses.fields(options)}:
        import_modules(args)
    _check_names(options, command, args, elsewhere or {})
    message = io.StringIO()
    try:
        with contextlib.redirect_stderr(message), _REGISTRY:
            return tyro.cli(options, prog=f"circle2d {command}", args=list(args))
    except SystemExit as exit_:
        if not exit_.code:
            raise
        raise UserError(_one_line(message.getvalue())) from None


def read_ahead(args: Sequence[str], **defaults: Any) -> argparse.Namespace:
    """Read a few options before the others are known. defaults: by name; a list collects."""
    ahead = argparse.ArgumentParser(add_help=False, exit_on_error=False, allow_abbrev=False)
    for name, default in defaults.items():
        action = "append" if isinstance(default, list) else "store"
        ahead.add_argument(f"--{name}", nargs="?", action=action, default=default)
    return ahead.parse_known_args(args)[0]


def import_modules(args: Sequence[str]) -> None:
    """Import the modules that `--import` names. Raises UserError where one cannot be imported."""
    for name in filter(None, vars(read_ahead(args, **{"import": []}))["import"]):
        if name.endswith(".py"):
            raise UserError(f"--import takes a module's name: {name.removesuffix('.py')!r}")
        try:
            importlib.import_module(name)
        except Exception as error:  # of the user's own code
            frames = traceback.extract_tb(error.__traceback__)
            own = [f for f in frames if "importlib" not in f.filename and f.filename != __file__]
            where = f" ({own[-1].filename}, line {own[-1].lineno})" if own else ""
            raise UserError(
                f"cannot import {name!r}: {type(error).__name__}: {error}{where}"
            ) from None


def _check_names(
    options: type, command: str, args: Sequence[str], elsewhere: Mapping[str, str]
) -> None:
    """Raise UserError for the first option that the command does not have."""
    valid = {f"--{name.replace('_', '-')}" for name in _names(options)} | {"--help"}
    for arg in args:
        name = arg.partition("=")[0].replace("_", "-")
        if re.match(r"--[A-Za-z]", name) and name not in valid:
            hint = elsewhere.get(name) or nearest(
                name, sorted(valid), f"'circle2d {command} --help' lists those it has"
            )
            raise UserError(f"{command} has no option {name}: {hint}")


def _names(options: type) -> Iterator[str]:
    """Names of the options that a dataclass stands for, those of nested ones among them."""
    hints = get_type_hints(options, include_extras=False)
    for field in dataclasses.fields(options):
        hint = hints[field.name]
        if dataclasses.is_dataclass(hint):
            assert isinstance(hint, type)
            yield from _names(hint)
        else:
            yield "import" if field.name == "imports" else field.name
            if hint is bool:
                yield f"no-{field.name}"


def _one_line(message: str) -> str:
    """Return the first paragraph of an error that tyro has drawn as a box, or between lines."""
    plain = re.sub(r"\x1b\[[0-9;]*m", "", message)
    lines = [re.sub(r"^[│|] *| *[│|]$", "", line).strip() for line in plain.splitlines()]
    paragraphs = [[]]
    for line in lines:
        if re.match(r"[─╭╰+]|-+$", line):  # a border; the upper one may hold the title
            paragraphs.append([])
        else:
            paragraphs[-1].append(line)
    texts = [" ".join(" ".join(paragraph).split()) for paragraph in paragraphs]
    texts = [text for text in texts if text]
    untitled = texts[0:1] if re.match("[╭+]", plain.lstrip()) else texts[1:2]
    return (untitled or texts or ["the options cannot be understood"])[0]


def _integers(info: Any) -> Any:
    """Rule of tyro: integers may be written as 1000000, 1_000_000 or 1e6."""
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
    """Read an integer, 1e6 among them. Raises ValueError for any other text."""
    try:
        if text.isascii():  # not the digits of any script
            return int(text)
    except ValueError:
        pass
    try:
        value = float(text if text.isascii() else "")
    except ValueError:
        value = 0.5
    if not value.is_integer():
        raise ValueError(f"must be an integer such as 1000000 or 1e6, got {text!r}")
    return int(value)


def check_suffix(path: Path, *allowed: str) -> None:
    """Raise UserError for a file to be written that has none of these suffixes."""
    if path.suffix.lower() not in allowed:
        raise UserError(f"out must end in {' or '.join(allowed)}, got {str(path)!r}")


def check_size(size: int) -> None:
    """Raise UserError for a picture's size that is not even and in [64, 4096] pixels."""
    if not 64 <= size <= 4096 or size % 2:
        raise UserError(f"size must be an even number in [64, 4096], got {size}")


_REGISTRY = tyro.constructors.ConstructorRegistry()
_REGISTRY.primitive_rule(_integers)
