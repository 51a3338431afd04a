"""What a person sees of a training while it runs; the timings go to a log of their own."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from agents.runs.config import TrainConfig
from agents.runs.train import Training

EVERY_SECONDS = 0.5


@contextlib.contextmanager
def show_progress(config: TrainConfig, folder: Path) -> Iterator[Callable[[Training], None]]:
    """Show steps, speed, recent returns and the time left on stderr.

    Yields the function to call after each epoch. `timing.log` gets a line for every hundredth of
    the training, stderr one for every tenth where it is no terminal.
    """
    console = Console(stderr=True)
    runs = len(config.seeds)
    started = shown = time.monotonic()
    first: int | None = None
    percent = -1
    with (folder / "timing.log").open("a") as log, _bar(console) as bar:
        title = f"{config.algorithm} {config.task} x {runs}"
        task = bar.add_task(title, total=config.steps, speed="", recent="")

        def on_epoch(training: Training) -> None:
            nonlocal first, shown, percent
            now, total = time.monotonic(), int(training.steps.sum())
            first = total if first is None else first
            going = training.steps[~training.failed]
            steps = int(going.min()) if len(going) else config.steps
            share = min(1.0, steps / config.steps)
            due = int(100 * share) > percent
            if now - shown < EVERY_SECONDS and not training.done and not due:
                return
            shown = now
            speed = f"{(total - first) / max(now - started, 1e-9):,.0f} steps/s"
            returns, cost = training.log.recent()
            recent = f"return {returns:.2f}, cost {cost:.2f}"
            bar.update(task, completed=min(steps, config.steps), speed=speed, recent=recent)
            if due or training.done:
                tenth = int(10 * share) > percent // 10
                percent = int(100 * share)
                line = f"{title}: {percent} % after {now - started:.0f} s, {speed}"
                print(line, file=log, flush=True)
                if tenth and not console.is_terminal:
                    print(f"{line}, {recent}", file=console.file, flush=True)

        yield on_epoch


def _bar(console: Console) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:.0f} %"),
        TextColumn("{task.fields[speed]}"),
        TextColumn("{task.fields[recent]}"),
        TimeRemainingColumn(),
        TextColumn("left"),
        console=console,
        disable=not console.is_terminal,
    )
