"""Signals that end a command: Ctrl-C, and those of batch systems and closed terminals."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # the command line starts without torch
    from agents.training.callbacks import Epoch

NAMES = ("SIGINT", "SIGTERM", "SIGHUP")
"""Not all of them are everywhere."""


class Ended(KeyboardInterrupt):
    """A signal that ends the command; raised where the program happens to be."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number


class _State:
    """How the command takes the next signal."""

    importing = False
    """Nothing is done yet: the process ends at once, since libraries that are being imported turn
    exceptions into others."""
    training: AfterEpoch | None = None


_state = _State()


def _handle(number: int, frame: object) -> None:
    if _state.importing:
        os.write(2, b"circle2d: interrupted\n")
        os._exit(128 + number)
    training = _state.training
    if training is None or training.number is not None or not training.follows:
        raise Ended(number)
    training.number = number


@contextlib.contextmanager
def handled() -> Iterator[None]:
    """Raise Ended at a signal, and restore the handlers at the end.

    A signal that is ignored, as by nohup, stays so.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = [getattr(signal, name) for name in NAMES if hasattr(signal, name)]
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


@contextlib.contextmanager
def importing() -> Iterator[None]:
    """End the process at once, in one line, at a signal while modules are imported."""
    _state.importing = True
    try:
        yield
    finally:
        _state.importing = False


class AfterEpoch:
    """Follows a training. The first signal stops it after the epoch, with a checkpoint; the second
    ends it at once, as one does where no epoch follows."""

    def __init__(self, imports: Sequence[str]) -> None:
        """imports: modules that `--import` named."""
        self._imports = imports
        self.number: int | None = None
        """Of the signal that came."""
        self.steps: dict[Path, tuple[int, int]] = {}
        """Steps taken and all steps of each folder, of the run that has taken the fewest."""

    @property
    def follows(self) -> bool:
        """Whether there is an epoch whose end a signal can wait for."""
        return any(taken < steps for taken, steps in self.steps.values())

    def __call__(self, epoch: Epoch) -> bool:
        """Note an epoch; False stops the training."""
        taken = (int(numbers["step"]) for numbers in epoch.runs.values())
        self.steps[epoch.folder] = (min(taken, default=epoch.steps), epoch.steps)
        if self.number is not None and not self.follows:
            raise Ended(self.number)
        return self.number is None

    def __enter__(self) -> AfterEpoch:
        _state.training = self
        return self

    def __exit__(self, *exception: object) -> None:
        _state.training = None

    def words(self) -> str:
        """One line on where the training was stopped. Only after a signal."""
        assert self.number is not None
        name = signal.Signals(self.number).name
        taken, steps = min(self.steps.values())
        folders = " ".join([*map(str, self.steps), *(f"--import {name}" for name in self._imports)])
        return (
            f"interrupted by {name} after {taken} of {steps} steps, with a checkpoint; "
            f"'circle2d resume {folders}' goes on"
        )
