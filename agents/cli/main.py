"""The command `circle2d`: finds the command's file, and turns errors into one line and a status.

Imports neither torch nor tyro nor matplotlib: what a command needs is imported when it runs.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import re
import signal
import sys
import traceback
import warnings
from collections.abc import Iterator, Sequence
from itertools import pairwise

from agents.cli import signals
from agents.errors import OwnCodeError, RunsFailed, UserError, extra_hint, nearest, one_line

COMMANDS = {
    "train": ("training", "train runs of an algorithm on tasks, evaluate them, print their table"),
    "resume": ("training", "go on with runs that were interrupted"),
    "evaluate": ("training", "play episodes with trained policies"),
    "reproduce": ("training", "run the paper's experiments, or a part of them, and report"),
    "report": ("showing", "write tables, training curves and heat maps of trained runs"),
    "compare": ("showing", "put two sets of runs side by side, with their differences"),
    "heatmap": ("showing", "draw which states were visited in training"),
    "export": ("showing", "write trained policies as safetensors or ONNX files, with a card"),
    "render": ("showing", "draw episodes of trained policies, side by side: PNG, GIF, MP4"),
    "scene": ("showing", "print the MuJoCo scene of a task (MJCF)"),
}
"""The file beside this one that has a function of each command's name, and what it does."""

MEANT = {"help": "--help", "version": "--version", "-v": "--version", "-V": "--version"}
"""Other programs' names of what this one has."""


def usage() -> str:
    """Text of `circle2d --help`."""
    from agents.algorithms import ALGORITHMS

    commands = "\n".join(f"  {name:<10} {text}" for name, (_, text) in COMMANDS.items())
    return (
        f"usage: circle2d COMMAND ...\n\n{commands}\n\n"
        "circle2d COMMAND --help explains the options of a command; circle2d --version prints the\n"
        f"version.\nAlgorithms: {', '.join(ALGORITHMS)}.\n"
    )


def main(args: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit status: 0 done, 1 a run or a task failed, 2 a mistake of the
    user, 128 and the number of the signal that ended it (130 for Ctrl-C)."""
    args = sys.argv[1:] if args is None else args
    if not args or args[0] in ("-h", "--help"):
        print(usage(), end="")
        return 0 if args else 2
    try:
        with signals.handled():
            if args[0] == "--version":
                from importlib.metadata import version

                print(f"circle2d-mj {version('circle2d-mj')}")
                return 0
            return _run(args[0], args[1:])
    except UserError as error:
        if isinstance(error, OwnCodeError) and error.__cause__:
            traceback.print_exception(error.__cause__)
        _say(error)
        return 1 if isinstance(error, (OwnCodeError, RunsFailed)) else 2
    except BrokenPipeError:  # nobody reads on
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 128 + signal.SIGPIPE
    except (OSError, MemoryError) as error:
        _say(error or "out of memory")
        return 2
    except KeyboardInterrupt as error:
        name = f" by {error}" if str(error) else ""
        how = "'circle2d resume' of a training, or the same 'circle2d reproduce', goes on"
        _say(f"interrupted{name}; {how}")
        return 128 + getattr(error, "number", 2)


def _say(words: object) -> None:
    """Print a line of the command's own."""
    print(f"circle2d: {one_line(words)}", file=sys.stderr)


def _run(command: str, args: Sequence[str]) -> int:
    """Run one command; returns the exit status. Raises UserError for an unknown one."""
    if command not in COMMANDS:
        kind = "option" if command.startswith("-") else "command"
        valid = ["--help", "--version"] if kind == "option" else list(COMMANDS)
        hint = f"did you mean {MEANT[command]!r}?" if command in MEANT else nearest(command, valid)
        given = command if len(command) < 80 else f"{command[:80]}..."
        raise UserError(f"unknown {kind} {given!r}: {hint}")
    with _current_folder_on_path(), warnings.catch_warnings():
        warnings.showwarning = _print_warning
        try:
            _check_words(args)
            with signals.importing():
                module = importlib.import_module(f"agents.cli.{COMMANDS[command][0]}")
            status = getattr(module, command)(args)
            sys.stdout.flush()
            return status
        except ModuleNotFoundError as error:
            if not (hint := extra_hint(error, command)):
                raise
            raise UserError(hint) from None


def _check_words(args: Sequence[str]) -> None:
    """Raise UserError for an empty word, as an unset variable leaves it."""
    for before, word in pairwise(("", *args)):
        if not word.strip() or word.endswith("="):
            name = word.removesuffix("=") if word.endswith("=") else before
            raise UserError(f"{name or 'an argument'} is followed by an empty word")


def _print_warning(message: object, *_: object) -> None:
    """Print a warning as a line of the command's own, without the colours of gymnasium's."""
    _say(re.sub(r"\x1b\[[0-9;]*m", "", str(message)))


@contextlib.contextmanager
def _current_folder_on_path() -> Iterator[None]:
    """Find the user's own modules in the current folder, after those that are installed."""
    folder = os.getcwd()
    if folder in sys.path or "" in sys.path:
        yield
        return
    sys.path.append(folder)
    try:
        yield
    finally:
        sys.path.remove(folder)
