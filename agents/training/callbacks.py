"""Callbacks after each epoch of a training: status, progress, kept policies, TensorBoard."""

from __future__ import annotations

import contextlib
import secrets
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from agents.errors import TaskFailure, UserError, extra
from agents.training import evaluation
from agents.training.config import STATUS, TrainConfig, is_of_policy, made_with, policy_path
from agents.training.environments import time_limit
from agents.training.files import AnyPath, read_json, write_arrays, write_json

if TYPE_CHECKING:
    from agents.training.trainer import Trainer

EVERY_SECONDS = 1.0
"""Least time between two writes of the status."""


@contextlib.contextmanager
def usual(trainer: Trainer) -> Iterator[tuple[Callable[[Trainer], object], ...]]:
    """Yield the callbacks that the configuration asks for, and the one that writes the status."""
    with contextlib.ExitStack() as stack:
        chosen: list[Callable[[Trainer], object]] = [keep_policies(trainer)]
        if trainer.config.tensorboard:
            chosen.append(stack.enter_context(contextlib.closing(Events(trainer))))
        if not trainer.done:
            chosen.append(stack.enter_context(contextlib.closing(StatusFile(trainer))))
        yield tuple(chosen)


@dataclass(frozen=True)
class Epoch:
    """An epoch of a training, for experiment trackers, tuners and notebooks.

    For each run that took part, `runs[seed]` has "step": environment steps taken; means over the
    epoch's episodes of "return", "length" and each cost by its name, such as "cost" (all
    undiscounted); "mcc": the greatest share of an episode in one streak of the first cost; and, if
    the run learned, the mean of each number that the algorithm's updates record, such as
    "critic_loss". With several tasks the key is (task, seed). `runs` is empty
    if all failed.
    """

    folder: Path
    algorithm: str
    task: str
    """The task, or several, with spaces between them."""
    steps: int
    """Environment steps that each run is asked to take; whole epochs may take more."""
    runs: Mapping[Any, Mapping[str, float]]
    """Numbers by seed and name: see above."""


def follower(on_epoch: Callable[[Epoch], object]) -> Callable[[Trainer], object]:
    """Return the callback for a function of an `Epoch`. If the function raises, the epoch is saved
    first; other callbacks must therefore come before this one."""

    def call(trainer: Trainer) -> object:
        config = trainer.config
        steps = dict(zip(config.runs, trainer.steps.tolist(), strict=True))
        runs = {
            run.seed if len(config.tasks) == 1 else run: {"step": float(steps[run]), **numbers}
            for run, numbers in trainer.recorder.latest.items()
        }
        task = " ".join(config.tasks)
        try:
            return on_epoch(Epoch(trainer.folder, config.algorithm, task, config.steps, runs))
        except BaseException:
            trainer.save()
            raise

    return call


def check_callback(on_epoch: object) -> None:
    """Raise UserError for an `on_epoch` that cannot be called."""
    if on_epoch is not None and not callable(on_epoch):
        raise UserError(f"on_epoch must be a function of an Epoch, got {on_epoch!r}")


def keep_policies(trainer: Trainer) -> Callable[[Trainer], None]:
    """Return a callback that keeps and evaluates policies at multiples of `evaluate_every`.

    Each file depends only on the state of the training: after a kill the same files are written
    again.
    """
    before = trainer.steps.copy()

    def call(trainer: Trainer) -> None:
        nonlocal before
        config, every = trainer.config, trainer.config.evaluate_every
        now, last = trainer.steps, before
        before = now.copy()
        if not every:
            return
        due = (trainer.failures == "") & (now // every > last // every)
        if not due.any():
            return
        results = evaluation.evaluate_runs(
            config, trainer.learner.policy(), evaluation.SNAPSHOT_EPISODES, due
        )
        state = trainer.learner.state_dict()
        kept = {k: v for k, v in state.items() if is_of_policy(k)} or state
        for k in np.flatnonzero(due).tolist():
            arrays = {name: array[k : k + 1] for name, array in kept.items()}
            for name, result in results.items():
                if isinstance(result.failure[k], TaskFailure):
                    place = f"{config.runs[k]}, {now[k]} steps"
                    warnings.warn(f"{place}: {result.why(k)}", stacklevel=2)
                if not result.void[k]:
                    of_run = result.of_run(k).items()
                    arrays |= {f"evaluation/{name}/{key}": values for key, values in of_run}
            path = policy_path(trainer.folder, config.runs[k], int(now[k] // every * every))
            path.parent.mkdir(parents=True, exist_ok=True)
            write_arrays(path, arrays)

    return call


class Reading(NamedTuple):
    """Progress of a training at some time."""

    seconds: float
    """Seconds since the measurement began."""
    steps: int
    """Environment steps of the run that has taken the fewest, without failed runs."""
    share: float
    """Share of the training that is done, in [0, 1]."""
    steps_per_second: float | None
    """Environment steps per second of all runs, since the first epoch; None before the second."""
    seconds_left: float | None
    """Estimated seconds left; None before the second epoch."""


class Meter:
    """Measures the progress of a training after each epoch.

    The first epoch of a process is not counted in the speed: it includes what is done only once.
    """

    def __init__(self, steps: int) -> None:
        """steps: environment steps of each run in total."""
        self._steps, self._started = steps, time.monotonic()
        self._first: tuple[float, int, float] | None = None

    def read(self, trainer: Trainer) -> Reading:
        """Return the current progress."""
        now, going = time.monotonic(), trainer.failures == ""
        steps = int(trainer.steps[going].min(initial=self._steps))
        share = min(1.0, steps / self._steps)
        taken = (now, int(trainer.steps.sum()), share)
        self._first = self._first or taken
        seconds, more, gained = (b - a for a, b in zip(self._first, taken, strict=True))
        known = seconds > 0 and gained > 0
        speed = more / seconds if known else None
        left = seconds * (1 - share) / gained if known else None
        return Reading(now - self._started, steps, share, speed, left)


def rounding(trainer: Trainer) -> str:
    """Return a line on the steps that whole epochs take beyond the steps asked for; "" if there are
    none, or no time limit is known."""
    config, episodes = trainer.config, trainer.learner.episodes
    limits = [time_limit(task, config.task_parameters) for task in config.tasks]
    epochs = [episodes * limit for limit in limits if limit]
    taken = max((-(-config.steps // epoch) * epoch for epoch in epochs), default=0)
    if taken <= config.steps:
        return ""
    whole = f"{episodes} whole episode{'s' * (episodes > 1)}"
    return (
        f"{config.steps:,} steps are rounded up to {taken:,}: an epoch is {whole}, which take "
        f"{max(epochs):,} steps if none ends early"
    )


@contextlib.contextmanager
def show_progress(config: TrainConfig) -> Iterator[Callable[[Trainer], None]]:
    """Show steps, speed, recent returns and the time left of a training on stderr.

    Yields the callback. On a terminal it shows a bar, elsewhere a line for every tenth of the
    training, and at the end the time of the evaluation, which no speed includes.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn

    title = f"{config.algorithm} {' '.join(config.tasks)} x {len(config.runs)}"
    percentage, words = TextColumn("{task.percentage:.0f} %"), TextColumn("{task.fields[words]}")
    console, meter, tenth, trained = Console(stderr=True), Meter(config.steps), -1, 0.0
    columns = (TextColumn("{task.description}"), BarColumn(), percentage, words)
    kernel = "C++" if config.backend == "c++" else "NumPy"
    print(f"{title}: networks are computed in {kernel}", file=console.file, flush=True)
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:
        shown = bar.add_task(title, total=config.steps, words="")

        def show(trainer: Trainer) -> None:
            nonlocal tenth, trained
            if tenth < 0 and (words := rounding(trainer)):
                console.print(words, markup=False, highlight=False, soft_wrap=True)
            now = meter.read(trainer)
            told = ["return {:.2f}, cost {:.2f}".format(*trainer.recorder.recent)]
            if now.steps_per_second is not None:
                told.insert(0, f"{now.steps_per_second:,.0f} steps/s")
            if trainer.done:
                told.append(f"evaluating {config.evaluation_episodes} episodes of each policy")
                trained = time.monotonic()
            elif now.seconds_left is not None:
                told.append(f"{duration(now.seconds_left)} left")
            bar.update(shown, completed=now.steps, words=", ".join(told))
            if int(10 * now.share) > tenth:
                tenth = int(10 * now.share)
                if not console.is_terminal:
                    after = f"{int(100 * now.share)} % after {now.seconds:.0f} s"
                    print(f"{title}: {', '.join([after, *told])}", file=console.file, flush=True)

        yield show
    if trained:
        took = duration(time.monotonic() - trained)
        print(
            f"{title}: the evaluation took {took}, not counted in the speeds above",
            file=console.file,
            flush=True,
        )


class StatusFile:
    """Callback that writes `status.json`: {"share": in [0, 1], "steps_per_second": a number or
    null, "sessions": {"random id of a process": {"seconds": ..., "versions": ..., "machine":
    ...}}}."""

    def __init__(self, trainer: Trainer) -> None:
        self._trainer, self._path = trainer, trainer.folder / STATUS
        self._meter, self._written = Meter(trainer.config.steps), -float("inf")
        self._before, self._session = sessions(trainer.folder), secrets.token_hex(8)
        self._made_with = made_with()

    def __call__(self, trainer: Trainer) -> None:
        """Write the status if it is due."""
        now = self._meter.read(trainer)
        if time.monotonic() - self._written >= EVERY_SECONDS or trainer.done:
            self._written = time.monotonic()
            own = {"seconds": round(now.seconds, 3)} | self._made_with
            content = {"share": now.share, "steps_per_second": now.steps_per_second}
            content |= {"sessions": self._before | {self._session: own}}
            write_json(self._path, content)

    def close(self) -> None:
        """Write a last time."""
        self._written = -float("inf")
        self(self._trainer)


def share_done(folder: AnyPath) -> float:
    """Return the share of a training that is done, in [0, 1]; 0 if it is unknown."""
    share = _status(folder).get("share")
    return float(share) if isinstance(share, (int, float)) and 0 <= share <= 1 else 0.0


def speed(folder: AnyPath) -> float | None:
    """Return the environment steps per second of all runs of a training; None if unknown."""
    value = _status(folder).get("steps_per_second")
    return float(value) if isinstance(value, (int, float)) else None


def sessions(folder: AnyPath) -> dict[str, dict[str, Any]]:
    """Return seconds, versions and machine of each process that trained, by its random id; empty if
    unknown. The time of a killed process after its last write is not counted."""
    content = _status(folder).get("sessions")
    return content if isinstance(content, dict) else {}


def other_session(folder: AnyPath) -> str:
    """Return a warning if other versions or another machine trained so far; "" if there is none."""
    now, before = made_with(), [*sessions(folder).values()]
    changed = [f"{k} {before[-1].get(k)}" for k in now if before and before[-1].get(k) != now[k]]
    if not changed:
        return ""
    return f"trained so far with other {' and '.join(changed)}: results may differ"


def _status(folder: AnyPath) -> dict[str, Any]:
    """Return the status; {} if the file cannot be read, since no result depends on it."""
    try:
        return read_json(folder / STATUS)
    except (UserError, OSError):
        return {}


def duration(seconds: float) -> str:
    """Return seconds in words: 3 h 2 min, 5 min, 40 s."""
    minutes = round(seconds / 60)
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{minutes // 60} h {minutes % 60} min" if minutes >= 60 else f"{minutes} min"


class Events:
    """Callback that writes TensorBoard event files, for each run in `tensorboard/RUN`.

    Event files hold times of day, unlike other records. After a resume, the events that an
    interrupted training had written after its checkpoint are marked as void.
    """

    def __init__(self, trainer: Trainer) -> None:
        extra("tensorboard", "tensorboard")
        from torch.utils.tensorboard import SummaryWriter

        folder = trainer.folder / "tensorboard"
        self._writers = {
            run: SummaryWriter(str(folder / run.prefix), purge_step=int(step) + 1)
            for run, step in zip(trainer.config.runs, trainer.steps, strict=True)
        }

    def __call__(self, trainer: Trainer) -> None:
        """Write the numbers of the last epoch."""
        steps = dict(zip(trainer.config.runs, trainer.steps, strict=True))
        for run, numbers in trainer.recorder.latest.items():
            for name, value in numbers.items():
                kind = "update" if name in trainer.recorder.metrics else "rollout"
                self._writers[run].add_scalar(f"{kind}/{name}", value, int(steps[run]))

    def close(self) -> None:
        """Write out what is buffered."""
        for writer in self._writers.values():
            writer.close()
