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

from agents.algorithms import ALGORITHMS
from agents.cli.explained import explained
from agents.errors import OTHER_NAMES, UserError, nearest

BackendChoice = Literal["auto", "compiled", "eager"]
Folder = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER")]
"""A folder that stands before the options."""
Folders = Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER ...")]
"""Several of them."""
MEANT = {
    f"--{other.replace('_', '-')}": f"--{name.replace('_', '-')}"
    for other, name in OTHER_NAMES.items()
} | {"--level": "--task Circle2D-1"}
"""Other programs' options, and what they are here."""
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
    check_arguments(options, command, args, elsewhere or {})
    message = io.StringIO()
    if {"-h", "--help"} & set(args):
        options = explained(options)
    try:
        with contextlib.redirect_stderr(message), _REGISTRY:
            return tyro.cli(options, prog=f"circle2d {command}", args=list(args))
    except SystemExit as exit_:
        if not exit_.code:
            raise
        raise UserError(_reworded(command, _one_line(message.getvalue()))) from None


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


def check_arguments(
    options: type, command: str, args: Sequence[str], elsewhere: Mapping[str, str] | None = None
) -> None:
    """Raise UserError for the first option that the command does not have, and for what stands
    before all options of a command that takes nothing there.

    elsewhere: options that the command has in other cases, by name, and in which.
    """
    valid = {f"--{name.replace('_', '-')}" for name in _names(options)} | {"--help"}
    if not _takes_folders(options) and args and not args[0].startswith("-"):
        hint = _nearest(args[0], valid, "options begin with --")
        if args[0] in ALGORITHMS and "--algorithm" in valid:
            hint = f"did you mean '--algorithm {args[0]}'?"
        raise UserError(f"{command} takes no argument {args[0]!r}: {hint}")
    for arg in args:
        name = arg.partition("=")[0].replace("_", "-")
        if re.match(r"--[A-Za-z]", name) and name not in valid:
            near = f"'circle2d {command} --help' lists those it has"
            hint = (elsewhere or {}).get(name) or _nearest(name, valid, near)
            raise UserError(f"{command} has no option {name}: {hint}")
        if re.fullmatch(r"\d+(,\d+)+,?", arg):
            one = f"'{arg.replace(',', '')}' or " if re.fullmatch(r"\d{1,3}(,\d{3})+", arg) else ""
            several = arg.replace(",", " ").strip()
            raise UserError(f"numbers have no commas: did you mean {one}'{several}'?")


def _nearest(given: str, valid: set[str], otherwise: str) -> str:
    """The hint to the option that was meant. The dashes make no two names similar."""
    meant = MEANT.get(given, "")
    if meant.partition(" ")[0] in valid:
        return f"did you mean {meant!r}?"
    names = sorted(name.removeprefix("--") for name in valid - {"--help"})
    return nearest(given.removeprefix("--"), names, otherwise).replace("mean '", "mean '--")


def _takes_folders(options: type) -> bool:
    """Whether a command has arguments besides its options."""
    hints = get_type_hints(options, include_extras=True)
    return any(tyro.conf.Positional in _marks(hint) for hint in hints.values())


def _marks(hint: Any) -> tuple[Any, ...]:
    return getattr(hint, "__metadata__", ())


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
    words = (untitled or texts or ["the options cannot be understood"])[0]
    words = re.sub(r"^Error parsing (?=--)", "", words)
    return re.sub(r"^Error parsing \w+: ", "", words)


_OURS = (
    (r"Missing from [^:]*: (\S+) (?:[A-Z]+ )?(.*?) *\(required\).*", r"{command} needs \1: \2"),
    (r"Missing value for argument '(--[\w-]+)'.*", r"\1 needs a value"),
    (r"(--[\w-]+): could not convert string to float: (.*)", r"\1 must be a number, got \2"),
    (r"(--[\w-]+): Failed to parse key-value pairs.*", r"\1 takes pairs: NAME VALUE ..."),
    (
        r"(--[\w-]+): Could not find valid parse for arguments: \['?(.*?)'?\]",
        r"\1 takes numbers with spaces between them, got '\2'",
    ),
    (
        r"(--[\w-]+): no type matching [^\[]*\[.* could be instantiated from \[(.*?)\]\..*",
        r"\1 takes numbers with spaces between them, got \2",
    ),
    (r"Unrecognized options: ([^,]*).*", r"{command} takes no argument '\1'"),
)
"""Messages of tyro, and the same in words of our own."""


def _reworded(command: str, words: str) -> str:
    for theirs, ours in _OURS:
        if re.fullmatch(theirs, words):
            return re.sub(theirs, ours.replace("{command}", command), words)
    return words


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


_REGISTRY = tyro.constructors.ConstructorRegistry()
_REGISTRY.primitive_rule(_integers)
