"""The command `circle2d`: runs a subcommand, and turns errors and signals (Ctrl-C, signals of batch
systems and closed terminals) into a one-line message and an exit status.

This module imports neither torch nor tyro nor matplotlib: a subcommand imports what it needs.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import os
import re
import signal
import sys
import threading
import warnings
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

from agents.errors import (
    FailedRunWarning,
    OwnCodeError,
    RunsFailed,
    UserError,
    extra_hint,
    nearest,
    no_exit,
    one_line,
    traced,
)

if TYPE_CHECKING:  # the command line starts without torch
    from agents.training.callbacks import Epoch

COMMANDS = {
    "train": ("training", "train runs of an algorithm on tasks, evaluate them, print their table"),
    "resume": ("training", "continue runs that were interrupted"),
    "grid": ("training", "train algorithms on tasks on all cores, and report"),
    "evaluate": ("policies", "play episodes with trained policies"),
    "reproduce": ("training", "run the paper's experiments, or a part of them, and report"),
    "zoo": ("showing", "list the trained agents that come with the package, and their results"),
    "report": ("showing", "write tables, training curves and heat maps of trained runs"),
    "plot": ("showing", "draw learning curves for a paper: PDF, SVG, PNG, PGF"),
    "compare": ("showing", "compare two sets of runs, with their differences"),
    "heatmap": ("showing", "draw which states were visited in training"),
    "export": ("policies", "write trained policies as safetensors or ONNX files, with a card"),
    "render": ("policies", "draw episodes of trained policies, side by side: PNG, GIF, MP4"),
    "scene": ("showing", "print the MuJoCo scene of a task (MJCF)"),
}
"""For each command: the module here that has a function of its name, and its description."""


def usage() -> str:
    """Return the text of `circle2d --help`."""
    from agents.algorithms import ALGORITHMS

    commands = "\n".join(f"  {name:<10} {text}" for name, (_, text) in COMMANDS.items())
    return (
        "usage: circle2d COMMAND ...   (or saferl COMMAND ..., the same program)\n\n"
        "A suite for safe reinforcement learning: tasks, algorithms, agents, metric.\n\n"
        f"{commands}\n\n"
        "circle2d COMMAND --help explains the options of a command; circle2d --version prints the\n"
        f"version.\nAlgorithms: {', '.join(ALGORITHMS)}.\n"
    )


def main(args: Sequence[str] | None = None) -> int:
    """Run a command; return the exit status: 0 done, 1 a run or the user's own code failed, 2 a
    mistake of the user, 128 plus the number of the signal that ended the command (Ctrl-C: 130)."""
    args = sys.argv[1:] if args is None else args
    if isinstance(sys.stdout, io.TextIOWrapper):  # it is None if stdout is closed
        sys.stdout.reconfigure(errors="replace")  # characters that a terminal's encoding lacks
    try:
        if not args or args[0] in ("-h", "--help"):
            print(usage(), end="", flush=True)
            return 0 if args else 2
        if args[0] == "--version":
            from importlib.metadata import version

            print(f"circle2d-mj {version('circle2d-mj')}")
            return 0
        return _run(args[0], args[1:])
    except UserError as error:
        failed = isinstance(error, (OwnCodeError, RunsFailed))
        if failed and error.__cause__:
            print(traced(error.__cause__), end="", file=sys.stderr)
        say(error)
        return 1 if failed else 2
    except BrokenPipeError:  # the reader of the pipe has gone
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 128 + signal.SIGPIPE
    except (OSError, MemoryError) as error:
        say(str(error) or "out of memory")
        return 2
    except KeyboardInterrupt as error:
        name = f" by {error}" if str(error) else ""
        how = "'circle2d resume' continues a training, the same 'circle2d reproduce' a grid"
        say(f"interrupted{name}; {how}")
        return 128 + getattr(error, "number", 2)


def say(words: object) -> None:
    """Print one line on stderr, beginning with the program's name."""
    print(f"circle2d: {one_line(words)}", file=sys.stderr)


def _run(command: str, args: Sequence[str]) -> int:
    """Run one command; return the exit status. Raises UserError for an unknown command."""
    if command not in COMMANDS:
        kind = "option" if command.startswith("-") else "command"
        valid = ["--help", "--version"] if kind == "option" else list(COMMANDS)
        raise UserError(f"unknown {kind} {command!r}: {nearest(command, valid)}")
    with warnings.catch_warnings():
        warnings.showwarning = _print_warning
        warnings.simplefilter("ignore", FailedRunWarning)
        try:
            _check_words(args)
            # Import before signals are handled: libraries turn errors raised meanwhile into others.
            module = importlib.import_module(f"agents.cli.{COMMANDS[command][0]}")
            with handling_signals(), no_exit():
                status = getattr(module, command)(args)
                print(end="", flush=True)
                return status
        except ModuleNotFoundError as error:
            if not (hint := extra_hint(error, command)):
                raise
            raise UserError(hint) from error  # the import may be in the user's code


def _check_words(args: Sequence[str]) -> None:
    """Raise UserError for an empty word, such as an unset shell variable leaves."""
    for before, word in pairwise(("", *args)):
        if not word.strip() or word.endswith("="):
            name = word.removesuffix("=") if word.endswith("=") else before
            raise UserError(f"{name or 'an argument'} is followed by an empty word")


def _print_warning(message: object, *_: object) -> None:
    """Print a warning by `say`, without the colours of gymnasium's warnings."""
    say(re.sub(r"\x1b\[[0-9;]*m", "", str(message)))


SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")
"""Signals to handle, where the platform has them."""


class Ended(KeyboardInterrupt):
    """Raised, wherever the program happens to be, by a signal that ends the command."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number


def _handle(number: int, frame: object) -> None:
    training = AfterEpoch.running
    if training is None or training.number is not None or not training.follows:
        raise Ended(number)
    training.number = number


@contextlib.contextmanager
def handling_signals() -> Iterator[None]:
    """Raise Ended at a signal, and restore the handlers at the end.

    A signal that is ignored, for example under nohup, stays ignored.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = [getattr(signal, name) for name in SIGNALS if hasattr(signal, name)]
    usual = (signal.SIG_DFL, signal.default_int_handler)
    before: dict[int, Any] = {n: signal.getsignal(n) for n in numbers}
    before = {number: handler for number, handler in before.items() if handler in usual}
    for number in before:
        signal.signal(number, _handle)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class AfterEpoch:
    """Callback that stops a training after a signal.

    The first signal stops the training after the current epoch, with a checkpoint; a second one, or
    one after the last epoch, ends it at once."""

    running: AfterEpoch | None = None
    """The callback of the training that this process runs."""

    def __init__(self, imports: Sequence[str]) -> None:
        """imports: modules named by `--import`."""
        self._imports = imports
        self.number: int | None = None
        """Number of the signal that was received."""
        self.steps: dict[Path, tuple[int, int]] = {}
        """For each folder: steps taken by its slowest run, and steps of a whole run."""

    @property
    def follows(self) -> bool:
        """Whether another epoch follows, at whose end a signal can stop the training."""
        return any(taken < steps for taken, steps in self.steps.values())

    def __call__(self, epoch: Epoch) -> bool:
        """Record an epoch; return False to stop the training."""
        taken = (int(numbers["step"]) for numbers in epoch.runs.values())
        self.steps[epoch.folder] = (min(taken, default=epoch.steps), epoch.steps)
        if self.number is not None and not self.follows:
            raise Ended(self.number)
        return self.number is None

    def __enter__(self) -> AfterEpoch:
        AfterEpoch.running = self
        return self

    def __exit__(self, *exception: object) -> None:
        AfterEpoch.running = None

    def words(self) -> str:
        """Return one line on where the training was stopped; call it only after a signal."""
        assert self.number is not None
        name = signal.Signals(self.number).name
        taken, steps = min(self.steps.values())
        folders = " ".join([*map(str, self.steps), *(f"--import {name}" for name in self._imports)])
        return (
            f"interrupted by {name} after {taken} of {steps} steps, with a checkpoint; "
            f"'circle2d resume {folders}' continues the training"
        )
