"""What a person sees of a training while it runs; the timings go to a log of their own."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

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
from agents.runs.config import TrainConfig
from agents.runs.train import OnEpoch, Training

EVERY_SECONDS = 0.5


@contextlib.contextmanager
def show_progress(configs: dict[Path, TrainConfig]) -> Iterator[OnEpoch]:
    """Show steps, speed, recent returns and the time left of folders that train together, on
    stderr.

    Yields the function to call after each epoch. `timing.log` of each folder gets a line for every
    hundredth of the training, stderr one for every tenth where it is no terminal.
    """
    console = Console(stderr=True)
    total_steps = next(iter(configs.values())).steps
    started = shown = time.monotonic()
    first: int | None = None
    percent = -1
    compiled = compiled_before = CLOCK.seconds
    with contextlib.ExitStack() as stack:
        logs = [stack.enter_context((folder / "timing.log").open("a")) for folder in configs]
        bar, title = stack.enter_context(_bar(console)), _title(list(configs.values()))
        task = bar.add_task(title, total=total_steps, speed="", recent="")

        def on_epoch(trainings: Sequence[Training]) -> None:
            nonlocal first, shown, percent, compiled
            taken = np.concatenate([training.steps for training in trainings])
            failed = np.concatenate([training.failed for training in trainings])
            now, total = time.monotonic(), int(taken.sum())
            first = total if first is None else first
            steps = int(taken[~failed].min(initial=total_steps))
            share, done = steps / total_steps, all(training.done for training in trainings)
            due = int(100 * share) > percent
            if now - shown < EVERY_SECONDS and not done and not due:
                return
            shown = now
            if CLOCK.seconds > compiled:
                compiled = CLOCK.seconds
                line = f"{title}: compiled in {compiled - compiled_before:.0f} s"
                for log in logs:
                    print(line, file=log, flush=True)
                if not console.is_terminal:
                    print(line, file=console.file, flush=True)
            training_for = now - started - (compiled - compiled_before)
            speed = f"{(total - first) / max(training_for, 1e-9):,.0f} steps/s"
            returns, cost = np.mean([training.log.recent() for training in trainings], axis=0)
            recent = f"return {returns:.2f}, cost {cost:.2f}"
            bar.update(task, completed=steps, speed=speed, recent=recent)
            if due or done:
                tenth = int(10 * share) > percent // 10
                percent = int(100 * share)
                line = f"{title}: {percent} % after {now - started:.0f} s, {speed}"
                for log in logs:
                    print(line, file=log, flush=True)
                if tenth and not console.is_terminal:
                    print(f"{line}, {recent}", file=console.file, flush=True)

        yield on_epoch


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
