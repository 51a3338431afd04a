"""Progress of a training on stderr."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn
from rich.text import Text

from agents.lockstep.backend import CLOCK
from agents.training.callbacks import EVERY_SECONDS, Meter, duration
from agents.training.config import TrainConfig
from agents.training.trainer import Trainer


@contextlib.contextmanager
def show_progress(config: TrainConfig) -> Iterator[Callable[[Trainer], None]]:
    """Show steps, speed, recent returns and the time left of a training on stderr.

    Yields the callback. A bar on a terminal; elsewhere a line for every tenth of the training.
    """
    console = Console(stderr=True)
    with _bar(console) as bar:
        yield _Display(config, console, bar)


def working(on: str) -> contextlib.AbstractContextManager[object]:
    """Show on a terminal that work goes on whose end cannot be foreseen."""
    return Console(stderr=True).status(on)


class _Display:
    """Progress of a training, seen from the process that goes on with it."""

    def __init__(self, config: TrainConfig, console: Console, bar: Progress) -> None:
        self.title = f"{config.algorithm} {' '.join(config.tasks)} x {len(config.runs)}"
        self.console, self.bar = console, bar
        self.task = bar.add_task(self.title, total=config.steps, speed="", recent="", left="")
        self.meter, self.shown = Meter(config.steps), time.monotonic()
        self.compiled = self.compiled_before = CLOCK.seconds
        self.tenth = -1

    def __call__(self, trainer: Trainer) -> None:
        """Show progress where that is due."""
        now, done = self.meter.read(trainer), trainer.done
        is_tenth = int(10 * now.share) > self.tenth
        if time.monotonic() - self.shown < EVERY_SECONDS and not done and not is_tenth:
            return
        self.shown = time.monotonic()
        if CLOCK.seconds > self.compiled:
            self.compiled = CLOCK.seconds
            self._print(f"compiled in {self.compiled - self.compiled_before:.0f} s")
        per_second = "" if now.steps_per_second is None else f"{now.steps_per_second:,.0f} steps/s"
        left = "" if now.seconds_left is None else f"{duration(now.seconds_left)} left"
        recent = "return {:.2f}, cost {:.2f}".format(*trainer.recorder.recent)
        if done:  # an evaluation follows
            recent, left = f"{recent}, evaluating", ""
        shown: dict[str, Any] = {"speed": per_second, "recent": recent, "left": left}
        self.bar.update(self.task, completed=now.steps, **shown)
        if is_tenth or done:
            self.tenth = int(10 * now.share)
            after = f"{int(100 * now.share)} % after {now.seconds:.0f} s"
            self._print(", ".join(filter(None, (after, per_second, recent, left))))

    def _print(self, text: str) -> None:
        """A line on stderr where that is no terminal."""
        if not self.console.is_terminal:
            print(f"{self.title}: {text}", file=self.console.file, flush=True)


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
