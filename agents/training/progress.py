"""What a person sees of a training while it runs; the timings go to a log of their own."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import IO, NamedTuple

import numpy as np
from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from agents.lockstep.compiling import CLOCK
from agents.training.config import TrainConfig
from agents.training.loop import OnEpoch, Training
from agents.training.timing import duration

EVERY_SECONDS = 0.5


@contextlib.contextmanager
def show_progress(configs: dict[Path, TrainConfig]) -> Iterator[OnEpoch]:
    """Show steps, speed, recent returns and the time left of folders that train together, on
    stderr.

    Yields the function to call after each epoch. `timing.log` of each folder gets a line for every
    hundredth of the training, stderr one for every tenth where it is no terminal.
    """
    console = Console(stderr=True)
    with contextlib.ExitStack() as stack:
        logs = [stack.enter_context((folder / "timing.log").open("a")) for folder in configs]
        bar = stack.enter_context(_bar(console))
        yield _Display(list(configs.values()), console, bar, logs).on_epoch


def working(on: str) -> AbstractContextManager[object]:
    """Show on a terminal that something goes on whose end cannot be told."""
    return Console(stderr=True).status(on)


class _Mark(NamedTuple):
    """How far trainings were at some time."""

    seconds: float
    """On a clock that stands still while the compiler works."""
    steps: int
    """Of all runs together."""
    share: float
    """Done, in [0, 1]."""


def _pace(first: _Mark, now: _Mark) -> tuple[str, str]:
    """Speed and time left as they are shown; empty where the two are the same."""
    seconds, share = now.seconds - first.seconds, now.share - first.share
    if not seconds or not share:
        return "", ""
    left = duration(seconds * (1 - now.share) / share)
    return f"{(now.steps - first.steps) / seconds:,.0f} steps/s", f"{left} left"


class _Display:
    """What is shown of trainings, as seen from the process that goes on with them."""

    def __init__(
        self, configs: Sequence[TrainConfig], console: Console, bar: Progress, logs: Sequence[IO]
    ) -> None:
        self.title, self.total_steps = _title(configs), configs[0].steps
        self.console, self.bar, self.logs = console, bar, logs
        self.task = bar.add_task(self.title, total=self.total_steps, speed="", recent="")
        self.started = self.shown = time.monotonic()
        self.compiled = self.compiled_before = CLOCK.seconds
        self.percent = -1
        self.first: _Mark | None = None
        """After the first epoch of this process, which is not counted, since it pays for what is
        done only once."""

    def on_epoch(self, trainings: Sequence[Training]) -> None:
        """Tell how far they are, where that is due."""
        taken = np.concatenate([training.steps for training in trainings])
        failed = np.concatenate([training.failed for training in trainings])
        steps, total = int(taken[~failed].min(initial=self.total_steps)), int(taken.sum())
        share, done = steps / self.total_steps, all(training.done for training in trainings)
        now, due = time.monotonic(), int(100 * share) > self.percent
        mark = _Mark(now - CLOCK.seconds, total, share)
        self.first = self.first or mark
        if now - self.shown < EVERY_SECONDS and not done and not due:
            return
        self.shown = now
        self._tell_compiling()
        speed, left = _pace(self.first, mark)
        returns, cost = np.mean([training.log.recent() for training in trainings], axis=0)
        recent = f"return {returns:.2f}, cost {cost:.2f}"
        if done:  # an evaluation follows
            recent, left = f"{recent}, evaluating", ""
        self.bar.update(self.task, completed=steps, speed=speed, recent=recent)
        if due or done:
            line = f"{self.title}: {int(100 * share)} % after {now - self.started:.0f} s"
            line += speed and f", {speed}"
            is_tenth = int(10 * share) > self.percent // 10
            self.percent = int(100 * share)
            self._tell(line, f"{line}, {recent}{left and ', '}{left}" if is_tenth else "")

    def _tell_compiling(self) -> None:
        if CLOCK.seconds > self.compiled:
            self.compiled = CLOCK.seconds
            line = f"{self.title}: compiled in {self.compiled - self.compiled_before:.0f} s"
            self._tell(line, line)

    def _tell(self, line: str, shown: str) -> None:
        """A line to the logs, and one to stderr where that is no terminal, unless it is empty."""
        for log in self.logs:
            print(line, file=log, flush=True)
        if shown and not self.console.is_terminal:
            print(shown, file=self.console.file, flush=True)


def _title(configs: Sequence[TrainConfig]) -> str:
    tasks = " ".join(dict.fromkeys(config.task for config in configs))
    return f"{configs[0].algorithm} {tasks} x {sum(len(config.seeds) for config in configs)}"


class _Compiling(ProgressColumn):
    """Says that, and since when, the compiler works; nothing otherwise."""

    def render(self, task: Task) -> Text:
        began = CLOCK.began
        return Text("" if began is None else f"compiling, {time.monotonic() - began:.0f} s")


def _bar(console: Console) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:.0f} %"),
        _Compiling(),
        TextColumn("{task.fields[speed]}"),
        TextColumn("{task.fields[recent]}"),
        TimeRemainingColumn(),
        TextColumn("left"),
        console=console,
        disable=not console.is_terminal,
    )
