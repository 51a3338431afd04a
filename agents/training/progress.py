"""Progress of a training on stderr."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn
from rich.text import Text

from agents.lockstep.compiling import CLOCK
from agents.training.config import TrainConfig
from agents.training.loop import OnEpoch, Training
from agents.training.status import Meter, duration

EVERY_SECONDS = 0.5


@contextlib.contextmanager
def show_progress(configs: dict[Path, TrainConfig]) -> Iterator[OnEpoch]:
    """Show steps, speed, recent returns and the time left of folders that train together.

    Yields the function to call after each epoch. A bar on a terminal; elsewhere a line for every
    tenth of the training.
    """
    console = Console(stderr=True)
    with _bar(console) as bar:
        yield _Display(list(configs.values()), console, bar).on_epoch


def working(on: str) -> AbstractContextManager[object]:
    """Show on a terminal that work goes on whose end cannot be foreseen."""
    return Console(stderr=True).status(on)


class _Display:
    """Progress of trainings, seen from the process that goes on with them."""

    def __init__(self, configs: Sequence[TrainConfig], console: Console, bar: Progress) -> None:
        self.title, self.total_steps = _title(configs), configs[0].steps
        self.console, self.bar = console, bar
        self.task = bar.add_task(self.title, total=self.total_steps, speed="", recent="", left="")
        self.meter, self.shown = Meter(self.total_steps), time.monotonic()
        self.compiled = self.compiled_before = CLOCK.seconds
        self.tenth = -1

    def on_epoch(self, trainings: Sequence[Training]) -> None:
        """Show progress where that is due."""
        now = self.meter.read(trainings)
        done = all(training.done for training in trainings)
        is_tenth = int(10 * now.share) > self.tenth
        if time.monotonic() - self.shown < EVERY_SECONDS and not done and not is_tenth:
            return
        self.shown = time.monotonic()
        if CLOCK.seconds > self.compiled:
            self.compiled = CLOCK.seconds
            self._print(f"compiled in {self.compiled - self.compiled_before:.0f} s")
        speed = "" if now.steps_per_second is None else f"{now.steps_per_second:,.0f} steps/s"
        left = "" if now.seconds_left is None else f"{duration(now.seconds_left)} left"
        returns, cost = np.mean([training.log.recent() for training in trainings], axis=0)
        recent = f"return {returns:.2f}, cost {cost:.2f}"
        if done:  # an evaluation follows
            recent, left = f"{recent}, evaluating", ""
        self.bar.update(self.task, completed=now.steps, speed=speed, recent=recent, left=left)
        if is_tenth or done:
            self.tenth = int(10 * now.share)
            after = f"{int(100 * now.share)} % after {now.seconds:.0f} s"
            self._print(", ".join(filter(None, (after, speed, recent, left))))

    def _print(self, text: str) -> None:
        """A line on stderr where that is no terminal."""
        if not self.console.is_terminal:
            print(f"{self.title}: {text}", file=self.console.file, flush=True)


def _title(configs: Sequence[TrainConfig]) -> str:
    tasks = " ".join(dict.fromkeys(config.task for config in configs))
    return f"{configs[0].algorithm} {tasks} x {sum(len(config.seeds) for config in configs)}"


class _Compiling(ProgressColumn):
    """For how long the compiler has been working; empty where it is not."""

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
        TextColumn("{task.fields[left]}"),
        console=console,
        disable=not console.is_terminal,
    )
