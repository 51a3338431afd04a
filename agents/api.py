"""The entrance from Python: the functions that `agents` exports.

They sit on top of everything but the command line, which is a thin skin over them. Each is a guest
in the caller's process: torch's threads, default device and matrix products are as before when it
returns or raises, and no signal handler is touched. One thing cannot be undone: on Linux, freed
memory stays with the process from the first training on, for the next tensor (`mallopt`).
"""

from __future__ import annotations

import contextlib
import dataclasses
import difflib
import functools
import operator
import shutil
import tempfile
import warnings
import weakref
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, ParamSpec, TypeVar

from agents.algorithms import Algorithm, register
from agents.errors import UserError
from agents.lockstep import backend as lockstep_backend
from agents.lockstep.compiling import cannot_compile, compiling_is_off
from agents.paper.presets import preset
from agents.reporting.report import report as write_report
from agents.results.reading import Group, read_groups
from agents.training import loop, playing
from agents.training.config import Backend, Device, TrainConfig, run_folder
from agents.training.environments import Vectorization, check_task
from agents.training.epochs import Epoch, follower
from agents.training.playing import Evaluation
from agents.training.policy import Policy, load_policy
from agents.training.progress import show_progress
from agents.training.tensorboard import require_tensorboard
from emcc import EpisodeRecords

if TYPE_CHECKING:
    import pandas

__all__ = (
    "Algorithm",
    "Epoch",
    "Evaluation",
    "Policy",
    "Runs",
    "UserError",
    "evaluate",
    "load_policy",
    "register",
    "report",
    "resume",
    "train",
)

OnEpoch = Callable[[Epoch], object]
"""Called after every epoch of each folder; returning False stops the training."""
P = ParamSpec("P")
T = TypeVar("T")


def _as_guest(function: Callable[P, T]) -> Callable[P, T]:
    """Restore torch's settings when the function returns or raises."""

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        with lockstep_backend.restored():
            return function(*args, **kwargs)

    return call


class Runs:
    """The runs of one folder, or of several that trained jointly, and all that they left."""

    def __init__(self, folders: Sequence[Path], temporary: bool = False) -> None:
        """temporary: remove the folders with this object."""
        self.folders = tuple(folders)
        self.configs = tuple(TrainConfig.read(folder) for folder in folders)
        """Of each folder."""
        if temporary:
            for folder in self.folders:
                weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)

    def __repr__(self) -> str:
        names = ", ".join(repr(str(folder)) for folder in self.folders)
        return f"Runs({names})"

    @property
    def folder(self) -> Path:
        """The folder. Raises ValueError where there are several: see `folders`."""
        if len(self.folders) > 1:
            raise ValueError(f"there are several folders, see `folders`: {self.folders}")
        return self.folders[0]

    @property
    def config(self) -> TrainConfig:
        """The configuration. Raises ValueError where there are several: see `configs`."""
        return self.configs[self.folders.index(self.folder)]

    @property
    def results(self) -> list[Group]:
        """Measures and records of the complete runs, for each folder.

        Raises UserError where no run is complete: a run that was stopped has `records` only.
        """
        return [group for folder in self.folders for group in read_groups(folder, [])]

    @property
    def records(self) -> dict[tuple[Path, int], EpisodeRecords]:
        """The episodes of every run so far, by folder and seed."""
        return {
            (folder, seed): EpisodeRecords.load(run_folder(folder, seed) / "episodes.csv")
            for folder, config in zip(self.folders, self.configs, strict=True)
            for seed in config.seeds
        }

    def table(self) -> str:
        """The table that the command prints, as Markdown; written into the folder too."""
        return "\n".join(write_report(folder) for folder in self.folders)

    def to_pandas(self) -> pandas.DataFrame:
        """A row for each episode of each run: algorithm, task, seed, then `episodes.csv`.

        Raises ImportError, saying how to install it, where pandas is missing.
        """
        try:
            import pandas as pd
        except ImportError:
            raise ImportError("to_pandas needs pandas: pip install pandas") from None
        configs = dict(zip(self.folders, self.configs, strict=True))
        frames = []
        for (folder, seed), records in self.records.items():
            config, columns = configs[folder], {}
            for field in dataclasses.fields(records):
                columns[field.name.rstrip("_")] = getattr(records, field.name)
            about = {"algorithm": config.algorithm, "task": config.task, "seed": seed}
            frames.append(pd.DataFrame({**dict.fromkeys(about), **columns}).assign(**about))
        return pd.concat(frames, ignore_index=True)


@_as_guest
def train(
    algorithm: str,
    task: str = "Circle2D-1-v0",
    *,
    seeds: int | Iterable[int] = (0, 1, 2),
    steps: int = 1_000_000,
    out: str | Path | None = None,
    task_parameters: dict[str, Any] | None = None,
    checkpoint_every: int = 50_000,
    evaluate_every: int | None = None,
    vectorization: Vectorization = "auto",
    backend: Backend | Literal["auto"] = "auto",
    device: Device = "cpu",
    tensorboard: bool = False,
    on_epoch: OnEpoch | None = None,
    progress: bool = False,
    **hyperparameters: Any,
) -> Runs:
    """Train runs of an algorithm on a task, one for each seed, and evaluate them.

    >>> import agents
    >>> runs = agents.train("sac-lb", seeds=1, steps=400, random_steps=300, gradient_steps=2)
    >>> [round(float(x)) for x in runs.records[runs.folder, 1].length]
    [50, 50, 50, 50, 50, 50, 50, 50]

    algorithm: a built-in one (`circle2d --help` lists them) or a registered one.
    task: id of a gymnasium task with `info["cost"]`, which "module:Id" imports.
    seeds: one run for each; a number is one seed.
    steps: environment steps of each run.
    out: folder for the runs; made, and refused where it holds runs already. None: a temporary one,
        which lives as long as the returned object.
    task_parameters: keyword arguments for the task.
    checkpoint_every: environment steps of a run between checkpoints.
    evaluate_every: environment steps of a run between evaluations, each of which leaves the policy
        too (`load_policy(..., step=...)`); None: no such. The other results stay what they are.
    vectorization: "auto": the task's own vector environment or one process; "sync": gymnasium's
        `SyncVectorEnv`; "async": a process for each environment. All give the same results.
    backend: how updates run: "compiled", "eager", or "auto": compiled where that is possible.
    device: "cpu" or "cuda".
    tensorboard: whether to write TensorBoard event files too.
    on_epoch: called with an `Epoch` after each epoch; returning False stops the training after a
        checkpoint, without the evaluation at its end. `resume` goes on.
    progress: whether to show progress on stderr.
    hyperparameters: those of the algorithm, over the preset for the task (the paper's on its tasks).

    Raises UserError for what is unknown or not allowed, before anything is written.
    """
    config = TrainConfig(
        algorithm,
        task,
        _seeds(seeds),
        steps,
        _hyperparameters(algorithm, task, hyperparameters),
        dict(task_parameters or {}),
        checkpoint_every,
        evaluate_every,
        vectorization,
        tensorboard,
        device=device,
    )
    check_task(config.task, config.task_parameters)
    if config.tensorboard:
        require_tensorboard()
    config = dataclasses.replace(config, backend=choose_backend(backend))
    folder = Path(tempfile.mkdtemp(prefix="agents-") if out is None else out)
    try:
        config.write(folder)
        _train([folder], on_epoch, progress)
    except BaseException:
        if out is None:
            shutil.rmtree(folder, ignore_errors=True)
        raise
    return Runs([folder], temporary=out is None)


@_as_guest
def resume(*folders: str | Path, on_epoch: OnEpoch | None = None, progress: bool = False) -> Runs:
    """Go on with the runs of folders, from their last checkpoints, as if never interrupted.

    Several folders, which differ in task and seeds only, train jointly, faster than one after the
    other. Folders that are done are evaluated again. on_epoch, progress: as in `train`. Raises
    UserError where there is nothing to go on with, or another process trains there.
    """
    if not folders:
        raise UserError("resume needs a folder of runs")
    paths = list(dict.fromkeys(map(Path, folders)))
    _train(paths, on_epoch, progress)
    return Runs(paths)


@_as_guest
@functools.wraps(playing.evaluate)
def evaluate(*args: Any, **kwargs: Any) -> Evaluation:
    return playing.evaluate(*args, **kwargs)


def report(folder: str | Path) -> str:
    """Write the report of all runs at or below a folder: the command `circle2d report`.

    Returns its tables as Markdown. Raises UserError where there are no complete runs.
    """
    return write_report(Path(folder), with_figures=True)


def choose_backend(choice: Backend | Literal["auto"]) -> Backend:
    """The backend that "auto" stands for on this machine.

    Warns where that is eager PyTorch, half as fast, for another reason than that PyTorch was told so
    by TORCH_COMPILE_DISABLE.
    """
    if choice != "auto":
        return choice
    why = cannot_compile()
    if why and not compiling_is_off():
        warnings.warn(f"updates run in eager PyTorch, half as fast: {why}", stacklevel=3)
    return "eager" if why else "compiled"


def _train(folders: Sequence[Path], on_epoch: OnEpoch | None, progress: bool) -> None:
    follow = follower(on_epoch, folders) if on_epoch else None
    with contextlib.ExitStack() as stack:
        show = None
        if progress:
            configs = {folder: TrainConfig.read(folder) for folder in folders}
            show = stack.enter_context(show_progress(configs))

        def after_epoch(trainings: Sequence[loop.Training]) -> bool:
            if show:
                show(trainings)
            return follow is None or follow(trainings) is not False

        loop.train(*folders, on_epoch=after_epoch)


def _seeds(seeds: int | Iterable[int]) -> tuple[int, ...]:
    try:
        return tuple(operator.index(s) for s in (seeds if isinstance(seeds, Iterable) else [seeds]))
    except TypeError:
        raise UserError(f"seeds must be an integer or several, got {seeds!r}") from None


def _hyperparameters(algorithm: str, task: str, given: dict[str, Any]) -> Any:
    """The preset of an algorithm for a task with the given values instead of its own."""
    config = preset(algorithm, task)
    names = [field.name for field in dataclasses.fields(config)]
    for name in given:
        if name not in names:
            near = difflib.get_close_matches(name, [*names, *_OPTIONS], n=1)
            hint = f"did you mean {near[0]}?" if near else f"it has {', '.join(names)}"
            raise UserError(f"{algorithm} has no hyper-parameter {name!r}: {hint}")
    values = {k: tuple(v) if isinstance(v, list) else v for k, v in given.items()}
    return dataclasses.replace(config, **values)


_OPTIONS = (
    "seeds",
    "steps",
    "out",
    "task_parameters",
    "checkpoint_every",
    "evaluate_every",
    "vectorization",
    "backend",
    "device",
    "tensorboard",
    "on_epoch",
    "progress",
)
