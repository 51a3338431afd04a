"""The entrance from Python: the functions that `agents` exports.

They sit on top of everything but the command line, which is a thin skin over them. Each is a guest
in the caller's process: torch's threads, default device, matrix products and limit of compilations
are as before when it returns or raises, and no signal handler is touched. Three things stay: on
Linux, freed memory is kept for the next tensor (`mallopt`); TORCHINDUCTOR_CACHE_DIR is set where it
was not; two callbacks measure the time of PyTorch's compiler.

>>> import agents, numpy as np
>>> runs = agents.train("trpo-lag", "Circle2D-1-v0", seeds=0, steps=200, episodes=2)
>>> policy = agents.load_policy(runs.folder)
>>> policy(np.zeros(2)).shape, policy(np.zeros((7, 2))).shape
((2,), (7, 2))
>>> agents.evaluate(policy, episodes=3).lengths.tolist()
[50, 50, 50]
>>> agents.resume(runs.folder).config.steps  # it is done: nothing changes
200
"""

from __future__ import annotations

import contextlib
import functools
import os
import shutil
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, ParamSpec, TypeVar

from agents.algorithms import Algorithm, register
from agents.arguments import configs_of, folder_to_write
from agents.errors import UserError
from agents.lockstep import backend as lockstep_backend
from agents.reporting.compare import compare as compare_runs
from agents.reporting.report import report as write_report
from agents.reporting.table import markdown
from agents.runs import Runs, folders_of, load_runs
from agents.sweeps import Values, sweep_configs, train_groups
from agents.training import loop
from agents.training.config import Backend, Device, TrainConfig
from agents.training.engines import EngineName
from agents.training.environments import Vectorization
from agents.training.epochs import Epoch, check_callback, follower
from agents.training.playing import Evaluation, evaluate
from agents.training.policy import Policy, load_policy
from agents.training.pretrained import pretrained
from agents.training.progress import show_progress

__all__ = (
    "Algorithm",
    "Epoch",
    "Evaluation",
    "Policy",
    "Runs",
    "UserError",
    "compare",
    "evaluate",
    "load_policy",
    "load_runs",
    "pretrained",
    "register",
    "report",
    "resume",
    "sweep",
    "train",
)

OnEpoch = Callable[[Epoch], object]
"""Called after every epoch of each folder; returning False stops the training."""
Folder = str | os.PathLike[str]
"""A path, or `Runs` of one folder, which stand for it."""
P = ParamSpec("P")
T = TypeVar("T")


def _as_guest(function: Callable[P, T]) -> Callable[P, T]:
    """Restore torch's settings when the function returns or raises."""

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        with lockstep_backend.restored():
            return function(*args, **kwargs)

    return call


@_as_guest
def train(
    algorithm: str,
    task: str = "Circle2D-1-v0",
    *,
    seeds: int | Iterable[int] = (0, 1, 2),
    steps: int = 1_000_000,
    out: Folder | None = None,
    task_parameters: Mapping[str, Any] | None = None,
    checkpoint_every: int = 50_000,
    evaluate_every: int | None = None,
    vectorization: Vectorization = "auto",
    step_timeout: float | None = None,
    backend: Backend | Literal["auto"] = "auto",
    device: Device = "cpu",
    tensorboard: bool = False,
    on_epoch: OnEpoch | None = None,
    progress: bool = False,
    engine: EngineName = "local",
    address: str | None = None,
    **hyperparameters: Any,
) -> Runs:
    """Train runs of an algorithm on a task, one for each seed, and evaluate them.

    >>> import agents
    >>> runs = agents.train("sac-lb", seeds=1, steps=400, random_steps=300, gradient_steps=2)
    >>> [round(float(x)) for x in runs.records[runs.folder, 1].length]
    [50, 50, 50, 50, 50, 50, 50, 50]

    algorithm: name of a built-in (`circle2d --help` lists them) or registered one. hyperparameters:
        values that replace those of the task's preset (on the paper's tasks, the paper's values).
    task: id of a gymnasium task with `info["cost"]`; "module:Id" imports the module first.
        task_parameters: keyword arguments for it.
    seeds: one run for each; a number is one seed. steps: environment steps of each run.
    out: folder for the runs; made, and refused where it holds runs already. None: a temporary one,
        which lives as long as the returned object.
    checkpoint_every: environment steps of a run between checkpoints. evaluate_every: environment
        steps of a run between evaluations; each also saves the policy, for
        `load_policy(..., step=...)`. None: evaluate only at the end.
    vectorization: "auto": the task's own vector environment or one process; "sync": gymnasium's
        `SyncVectorEnv`; "async": a process for each environment. All give the same results.
        step_timeout: seconds that a step may take with "async"; None: no limit.
    backend: how updates run: "compiled", "eager", or "auto": compiled where that is possible.
    tensorboard: whether to write event files too. progress: whether to show it on stderr.
    on_epoch: called with an `Epoch` after each epoch; returning False stops the training after a
        checkpoint, without the evaluation at its end. `resume` goes on.
    engine: "local": in this process; "ray": as a task of a Ray cluster, which supports neither
        on_epoch nor progress. address: of the cluster, "HOST:PORT" or "auto"; None: RAY_ADDRESS,
        or else a new cluster on this machine.

    Raises UserError for an unknown or invalid argument, before anything is written.
    """
    settings = {"checkpoint_every": checkpoint_every, "evaluate_every": evaluate_every}
    settings |= {"vectorization": vectorization, "step_timeout": step_timeout}
    settings |= {"device": device, "tensorboard": tensorboard}
    runs = (seeds, steps, task_parameters)
    (config,) = configs_of(algorithm, task, *runs, [hyperparameters], backend, settings)
    return _start(config, out, on_epoch, progress, engine, address)


def sweep(
    algorithm: str,
    task: str = "Circle2D-1-v0",
    *,
    grid: Mapping[str, Values],
    seeds: int | Iterable[int] = (0, 1, 2),
    steps: int = 1_000_000,
    out: Folder,
    task_parameters: Mapping[str, Any] | None = None,
    checkpoint_every: int = 50_000,
    evaluate_every: int | None = None,
    vectorization: Vectorization = "auto",
    step_timeout: float | None = None,
    backend: Backend | Literal["auto"] = "auto",
    device: Device = "cpu",
    tensorboard: bool = False,
    engine: EngineName = "local",
    workers: int | None = None,
    address: str | None = None,
    **hyperparameters: Any,
) -> Runs:
    """Train an algorithm with every combination of some hyper-parameters.

    grid: values of each hyper-parameter by its name: {"cost_limit": (1.0, 5.0), ...}. Each
        combination has a folder below `out`, named by its values. Given again, the same call goes
        on where it was interrupted. workers: processes, or tasks of Ray, at a time; by default as
        many as there are cores. The other arguments are those of `train`.

    Raises UserError for what is unknown or not allowed, before anything is written, and where a
    training fails; the others are done by then.
    """
    combinations, folder = sweep_configs(grid), folder_to_write(out)
    for name in grid.keys() & hyperparameters.keys():
        raise UserError(f"{name} is given twice: in the grid, and as {hyperparameters[name]!r}")
    settings = {"checkpoint_every": checkpoint_every, "evaluate_every": evaluate_every}
    settings |= {"vectorization": vectorization, "step_timeout": step_timeout}
    settings |= {"device": device, "tensorboard": tensorboard}
    runs = (seeds, steps, task_parameters)
    chosen = [hyperparameters | values for values in combinations.values()]
    found = configs_of(algorithm, task, *runs, chosen, backend, settings)
    configs = {folder / name: of for name, of in zip(combinations, found, strict=True)}
    train_groups(configs, engine, workers, address)
    return Runs(list(configs))


@_as_guest
def resume(*folders: Folder, on_epoch: OnEpoch | None = None, progress: bool = False) -> Runs:
    """Go on with the runs of folders, from their last checkpoints, as if never interrupted.

    Several folders, which differ in task and seeds only, train jointly, faster than one after the
    other. Folders that are done are evaluated again. on_epoch, progress: as in `train`. Raises
    UserError where there is nothing to go on with, or another process trains there.
    """
    if not folders:
        raise UserError("resume needs a folder of runs")
    check_callback(on_epoch)
    paths = list(dict.fromkeys(folders_of(*folders)))
    _train(paths, on_epoch, progress)
    return Runs(paths)


def report(*paths: Folder, archive: Folder | None = None, out: Folder | None = None) -> str:
    """Write the report of all runs at or below some folders, or in archives: `circle2d report`.

    paths: folders, archives, folders of archives (`runs.zip/Circle2D-1-v0`), or runs, such as
    `train` returns. Folders that differ in their seeds alone count as one. Returns the main
    tables and the paper's claims as Markdown. archive: a file to pack all that the report needs
    into. out: folder to write to; by default that of the runs, for an archive the one beside it
    that has its name without the suffix; several paths need one. Raises UserError where there are
    no complete runs, or an archive is damaged.
    """
    file = None if archive is None else Path(archive)
    folder = None if out is None else folder_to_write(out)
    return markdown(write_report(*folders_of(*paths), archive=file, out=folder).blocks)


def compare(a: Folder, b: Folder, out: Folder | None = None) -> str:
    """The tables of two sets of runs with the differences B - A, as Markdown: `circle2d compare`.

    a, b: as the paths of `report`, such as a baseline's runs and those of an idea. With out, writes
    `compare.md`, `compare.csv`, and `compare.html` with the training curves of both, to that
    folder. Raises UserError where a side has no complete run, or the two have no task in common.
    """
    return markdown(compare_runs(Path(a), Path(b), None if out is None else folder_to_write(out)))


def _start(
    config: TrainConfig,
    out: Folder | None,
    on_epoch: OnEpoch | None,
    progress: bool,
    engine: EngineName,
    address: str | None,
) -> Runs:
    """Make the folder of some runs and train them."""
    check_callback(on_epoch)
    if engine != "local" and (on_epoch or progress):
        raise UserError("on_epoch and progress are of the engine local")
    folder = Path(tempfile.mkdtemp(prefix="agents-")) if out is None else folder_to_write(out)
    try:
        if engine == "local" and address is None:
            config.write(folder)
            _train([folder], on_epoch, progress)
        else:
            if (folder / "config.json").exists():
                raise UserError(f"{folder} holds runs already")
            train_groups({folder: config}, engine, None, address)
    except BaseException:
        if out is None:
            shutil.rmtree(folder, ignore_errors=True)
        raise
    return Runs([folder], temporary=out is None)


def _train(folders: Sequence[Path], on_epoch: OnEpoch | None, progress: bool) -> None:
    follow = follower(on_epoch, folders) if on_epoch else lambda trainings: True
    with contextlib.ExitStack() as stack:
        show = None
        if progress:
            configs = {folder: TrainConfig.read(folder) for folder in folders}
            show = stack.enter_context(show_progress(configs))

        def after_epoch(trainings: Sequence[loop.Training]) -> object:
            if show:
                show(trainings)
            return follow(trainings)

        loop.train(*folders, on_epoch=after_epoch)
