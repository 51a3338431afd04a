"""The Python interface: functions that `agents` exports for training and reporting.

They use all other modules; the command line is a thin layer on top of them. In the caller's process
they leave no trace: when a function returns or raises, torch's threads and the networks' backend
are as before, and no signal handler has changed.

>>> import agents, numpy as np
>>> runs = agents.train("trpo-lag", "Circle2D-1-v0", seeds=0, steps=200, episodes=2)
>>> policy = agents.load_policy(runs.folder)
>>> policy(np.zeros(2)).shape, policy(np.zeros((7, 2))).shape
((2,), (7, 2))
>>> agents.evaluate(policy, episodes=3).lengths.tolist()
[50, 50, 50]
>>> agents.resume(runs.folder).config.steps  # already done: nothing changes
200
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import itertools
import os
import re
import shutil
import tempfile
import warnings
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from agents.algorithms import BUILT_IN, module_of
from agents.checks import as_integer
from agents.errors import FailedRunWarning, RemoteTraceback, RunsFailed, UserError, extra
from agents.lockstep import backend as lockstep_backend
from agents.lockstep.kernel import Backend
from agents.presets import PresetName, preset_with, recipe
from agents.runs import Runs, folders_of
from agents.training import callbacks, trainer
from agents.training.callbacks import Epoch
from agents.training.config import CONFIG, TrainConfig, file_name, finished
from agents.training.derive import failed_runs
from agents.training.environments import Vectorization, check_task, module_of_task, task_id
from agents.training.files import check_folder

if TYPE_CHECKING:
    from agents.reporting.study import Study

EngineName = Literal["local", "ray"]
OnEpoch = Callable[[Epoch], object]
"""Called after every epoch; returning False stops the training."""
Folder = str | os.PathLike[str]
"""A path, or the `Runs` of one folder, which can be given instead of its path."""
Values = Collection[Any]
"""Values of a hyper-parameter."""


@lockstep_backend.restored()
def train(
    algorithm: str,
    task: str | Iterable[str] = "Circle2D-1-v0",
    *,
    seeds: int | Iterable[int] = TrainConfig.seeds,
    steps: int | None = None,
    out: Folder | None = None,
    task_parameters: Mapping[str, Any] | None = None,
    costs: Sequence[str] = TrainConfig.costs,
    checkpoint_every: int = TrainConfig.checkpoint_every,
    evaluate_every: int | None = TrainConfig.evaluate_every,
    evaluation_episodes: int = TrainConfig.evaluation_episodes,
    vectorization: Vectorization = TrainConfig.vectorization,
    step_timeout: float | None = TrainConfig.step_timeout,
    backend: Backend = TrainConfig.backend,
    tensorboard: bool = TrainConfig.tensorboard,
    preset: PresetName = "paper",
    on_epoch: OnEpoch | None = None,
    progress: bool = False,
    engine: EngineName = "local",
    address: str | None = None,
    **hyperparameters: Any,
) -> Runs:
    """Train runs of an algorithm, one for each task and seed, and evaluate them.

    >>> import agents
    >>> runs = agents.train("sac-lb", seeds=1, steps=400, random_steps=300, gradient_steps=2)
    >>> [round(float(x)) for x in runs.records[runs.folder, 1].length]
    [50, 50, 50, 50, 50, 50, 50, 50]

    algorithm: name of a built-in algorithm (`circle2d --help` lists them) or a registered one;
        "zoo": the zoo's algorithm for the task, with its preset and number of steps.
    hyperparameters: values that replace those of the task's preset. preset: "paper", the paper's
        values on its tasks and their families, "zoo", those of the agents that come with the
        package, or "none", the algorithm's defaults: see `agents.presets`.
    task: id of a gymnasium task with `info["cost"]`, or several tasks with equal observations,
        actions and presets; "module:Id" imports the module first. task_parameters: keyword
        arguments for each task.
    seeds: one run for each; a number is one seed. steps: environment steps of each run; None: as
        many as the zoo's runs had, or 1 000 000.
    out: folder for the runs; created, and refused if it already holds runs. None: a temporary
        folder, which exists as long as the returned object.
    costs: names of costs in the task's info: all are recorded and evaluated; an algorithm limits
        the first one, or as many as it supports.
    checkpoint_every: environment steps of a run between checkpoints. evaluate_every: environment
        steps of a run between evaluations, whose results are in `Runs.to_pandas("evaluations")`;
        each also saves the policy, for `load_policy(..., step=...)`. None: evaluate only at the
        end. evaluation_episodes: of each policy, deterministic and stochastic, at the end.
    vectorization: "auto": the task's own vector environment or one process; "sync": gymnasium's
        `SyncVectorEnv`; "async": a process for each environment. All give the same results.
    step_timeout: seconds that a step may take with "async"; None: no limit.
    backend: how networks are computed: "c++", for which a compiler is needed once, or "numpy", half
        as fast, which is also used, with a warning, if there is no compiler.
    tensorboard: whether to write event files too. progress: whether to show progress on stderr.
    on_epoch: called with an `Epoch` after each epoch; returning False stops the training after a
        checkpoint, without the final evaluation. `resume` continues it.
    engine: "local": in this process; "ray": as a task of a Ray cluster, which supports neither
        on_epoch nor progress. address: of the cluster, "HOST:PORT" or "auto"; None: RAY_ADDRESS
        if set, else a new cluster on this machine.

    Warns about each run that failed. Raises UserError for an unknown or invalid argument, before
    anything is written, and if every run failed; the `__cause__` is then the error of the task's or
    the algorithm's own code.
    """
    task = ids_of(task)
    if algorithm == "zoo":
        algorithm, preset, usual = of_zoo(task, preset)
        steps = usual if steps is None else steps
    given = settings_of(locals())
    place = None if out is None else _to_write(out)  # before anything that takes long
    (config,) = configs_of(algorithm, task, [hyperparameters], preset, backend, given)
    return train_config(config, place, on_epoch, progress, engine, address)


def train_config(
    config: TrainConfig,
    out: Folder | None,
    on_epoch: OnEpoch | None,
    progress: bool,
    engine: EngineName = "local",
    address: str | None = None,
) -> Runs:
    """Train the runs of a configuration: see `train`."""
    place = None if out is None else _to_write(out)
    callbacks.check_callback(on_epoch)
    if engine != "local" and (on_epoch or progress):
        raise UserError("on_epoch and progress need the engine local")
    folder = Path(tempfile.mkdtemp(prefix="agents-")) if place is None else place
    try:
        if engine == "local" and address is None:
            config.write(folder)
            _train(folder, config, on_epoch, progress)
        else:
            if (folder / CONFIG).exists():
                raise UserError(f"{folder} holds runs already")
            _launch({folder: config}, engine, None, address, split=False)
    except BaseException:
        if out is None:
            shutil.rmtree(folder, ignore_errors=True)
        raise
    runs = Runs([folder], out is None, [config])
    _warn_of_failures(runs, 5)  # two frames more, for train and its decorator
    return runs


def sweep(
    algorithm: str,
    task: str | Iterable[str] = "Circle2D-1-v0",
    *,
    grid: Mapping[str, Values],
    out: Folder,
    preset: PresetName = "paper",
    backend: Backend = "c++",
    engine: EngineName = "local",
    workers: int | None = None,
    address: str | None = None,
    **settings: Any,
) -> Runs:
    """Train an algorithm with every combination of hyper-parameters.

    grid: values of each hyper-parameter by name: {"cost_limit": (1.0, 5.0), ...}. Each combination
        has a folder below `out`, named after its values; if there are more workers than
        combinations, its runs are split over several folders below it. Given again, the same call
        continues where it was interrupted. workers: number of processes, or tasks of Ray, at the
        same time; by default one per core. settings: other arguments of `train`, including
        hyper-parameters, but not on_epoch or progress.

    Warns about each run that failed, if others did not. Raises UserError for an unknown or invalid
    argument, before anything is written, and, after all others are done, if every run failed or a
    training ended early.
    """
    combinations, folder = combinations_of(grid), _to_write(out)
    for name in ("on_epoch", "progress"):
        if name in settings:
            raise UserError(f"sweep takes no {name}: it trains in other processes")
    given = settings_of(settings)
    settings = {name: value for name, value in settings.items() if name not in given}
    for name in (*settings_of(grid), *({"task"} & grid.keys())):
        raise UserError(f"grid takes hyper-parameters; {name} is the same for a whole sweep")
    for name in grid.keys() & settings.keys():
        raise UserError(f"{name} is given twice: in the grid, and as {settings[name]!r}")
    chosen = [settings | values for values in combinations.values()]
    configs = configs_of(algorithm, task, chosen, preset, backend, given)
    by_folder = {folder / name: c for name, c in zip(combinations, configs, strict=True)}
    runs = Runs(_launch(by_folder, engine, workers, address, split=len(by_folder) > 1))
    _warn_of_failures(runs)
    return runs


def grid(
    algorithms: str | Iterable[str],
    tasks: str | Iterable[str] = "Circle2D-1-v0",
    *,
    out: Folder,
    preset: PresetName = "paper",
    backend: Backend = "c++",
    engine: EngineName = "local",
    workers: int | None = None,
    address: str | None = None,
    **settings: Any,
) -> Runs:
    """Train several algorithms on several tasks, each with its preset: `circle2d grid`.

    Each pair has the folder `out/TASK/ALGORITHM`; if there are more workers than pairs, its runs
    are split over several folders below it. Given again, the same call continues where it was
    interrupted.
    settings: other arguments of `train`, but not on_epoch or progress; hyper-parameters among them
    apply to every algorithm. workers: number of processes, or tasks of Ray, at the same time; by
    default one per core.

    Warns about each run that failed, if others did not. Raises UserError for an unknown or invalid
    argument, before anything is written, and, after all others are done, if every run failed or a
    training ended early.
    """
    by_folder = grid_configs(algorithms, tasks, _to_write(out), preset, backend, settings)
    runs = Runs(_launch(by_folder, engine, workers, address, split=True))
    _warn_of_failures(runs)
    return runs


def grid_configs(
    algorithms: str | Iterable[str],
    tasks: str | Iterable[str],
    out: Path,
    preset: PresetName,
    backend: Backend,
    settings: Mapping[str, Any],
) -> dict[Path, TrainConfig]:
    """Return the configurations of `grid` by folder."""
    for name in settings.keys() & {"on_epoch", "progress"}:
        raise UserError(f"grid takes no {name}: it trains in other processes")
    if not (names := several(algorithms)):
        raise UserError("grid needs at least one algorithm")
    given = settings_of(settings)
    own = {name: value for name, value in settings.items() if name not in given}
    return {
        out / file_name(task) / name: config
        for task in dict.fromkeys(ids_of(tasks))
        for name in dict.fromkeys(names)
        for config in configs_of(name, task, [own], preset, backend, given)
    }


@lockstep_backend.restored()
def resume(
    *folders: Folder,
    steps: int | None = None,
    on_epoch: OnEpoch | None = None,
    progress: bool = False,
) -> Runs:
    """Continue the runs of folders from their newest checkpoints, as if never interrupted.

    Folders train one after the other; a finished folder without `results.npz` gets the file, and
    one with it stays unchanged. steps: a new, greater number of environment steps for each run:
    finished trainings continue too, bit for bit as if they had had that number from the start.
    on_epoch, progress: as in `train`. Raises UserError if a folder holds no runs, another process
    trains there, every run failed, or runs already have more steps.
    """
    if not folders:
        raise UserError("resume needs a folder of runs")
    callbacks.check_callback(on_epoch)
    paths = list(dict.fromkeys(path.absolute() for path in folders_of(*folders)))
    steps = as_integer(steps)
    for path in paths:
        TrainConfig.read(path)
        if steps is not None:
            trainer.check_longer(path, steps)
    for path in paths:
        if steps is not None:
            trainer.lengthen(path, steps)
    runs = Runs(paths, of=folders)
    for path, config in zip(paths, runs.configs, strict=True):
        if _train(path, config, on_epoch, progress).stopped:
            break
    _warn_of_failures(runs, 4)
    return runs


def report(
    *paths: Folder,
    study: Study | None = None,
    archive: Folder | None = None,
    out: Folder | None = None,
    columns: str | Sequence[str] | None = None,
    window: int | None = None,
) -> str:
    """Write the report of all runs at or below folders, or in archives: `circle2d report`.

    Returns the main tables and the study's claims as Markdown. Folders that differ only in their
    seeds count as one.

    paths: folders, archives, folders in archives (`runs.zip/Circle2D-1-v0`), or `Runs`, as returned
        by `train`.
    study: adds its own printed numbers, tables, figures and claims; by default that of `use_study`.
    archive: a file to write, from which the report can be made again. out: folder to write to,
        required with several paths; by default the runs' own, for `runs.zip` the folder `runs` next
        to it.
    columns: of `report.tex`, named as in `report.md`; by default those that fit the width of a
        text. window: episodes per window for EMCC, instead of rollouts: see
        `emcc.EpisodeRecords.windows`.

    Raises UserError if there are no complete runs, or an archive is damaged.
    """
    from agents.reporting.report import report as write_report
    from agents.reporting.table import LATEX_COLUMNS, markdown
    from agents.studies import used_study

    file = None if archive is None else Path(archive)
    folder = None if out is None else _to_write(out)
    written = write_report(
        *folders_of(*paths),
        study=study or used_study(),
        archive=file,
        out=folder,
        columns=LATEX_COLUMNS if columns is None else several(columns),
        window=window,
    )
    return markdown(written.blocks)


def compare(
    a: Folder,
    b: Folder,
    out: Folder | None = None,
    measures: str | Sequence[str] | None = None,
) -> str:
    """Return the tables of two sets of runs and their differences B - A as Markdown: `circle2d
    compare`.

    a, b: a folder, an archive, or `Runs` of one folder, for example a baseline's and your own.
    out: folder for `compare.md`, `compare.tex`, `compare.csv`, and `compare.html` with the training
        curves of both; None: nothing is written.
    measures: names of the measures to test, such as "J_R", by default all: p values are corrected
        for the number of tests.

    Raises UserError if a side has no complete run, or the two have no task in common.
    """
    from agents.reporting.compare import compare as compare_runs
    from agents.reporting.table import markdown

    folder = None if out is None else _to_write(out)
    asked = None if measures is None else several(measures)
    return markdown(compare_runs(Path(a), Path(b), folder, asked))


def plot(
    *paths: Folder,
    out: Folder,
    measures: str | Sequence[str] = ("return", "cost", "emcc"),
    names: Mapping[str, str] | None = None,
    colours: Mapping[str, str] | None = None,
    width: float = 5.5,
) -> str:
    """Draw learning curves of runs for a paper: `circle2d plot`. Returns a caption.

    paths: folders of runs, folders above such folders, or archives. out: file to write, .pdf, .svg,
        .png, or .pgf, for which xelatex must be installed.
    measures: "return", "cost", "emcc" and "length", a column of panels each; each task has a row.
    names, colours: new names and matplotlib colours of legend entries, by the entries' default
        names, such as {"TRPO-Lag": "baseline"}.
    width: inches. Text is 8 points high at any width, so give the width in print.

    Raises UserError if no run is complete, and for a name that no curve has.
    """
    from agents.reporting.plot import plot as draw

    return draw(folders_of(*paths), Path(out), several(measures), names, colours, width).words


def settings_of(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return those arguments that are settings of any training: fields of a configuration, without
    those that `configs_of` takes as arguments of its own; seeds and costs as tuples."""
    names = {field.name for field in dataclasses.fields(TrainConfig)}
    apart = {"algorithm", "tasks", "hyperparameters", "backend"}
    settings = {name: value for name, value in values.items() if name in names - apart}
    return settings | {k: several(settings[k]) for k in {"seeds", "costs"} & settings.keys()}


def several(given: Any) -> tuple[Any, ...]:
    """Return the values of an argument that may be a single one, such as a task or a seed."""
    return tuple(given) if isinstance(given, Iterable) and not isinstance(given, str) else (given,)


def ids_of(task: Any) -> tuple[str, ...]:
    """Return the full ids of a task or several. Raises UserError for none, and for unknown ones."""
    if not (tasks := several(task)):
        raise UserError("task must be the id of a gymnasium task, or several ids, got none")
    return tuple(map(task_id, tasks))


def of_zoo(tasks: Sequence[str], preset: PresetName) -> tuple[str, PresetName, int]:
    """Return the zoo's algorithm for tasks, its preset, and its number of steps. Raises UserError
    for a task without a recipe, for tasks with different recipes, and for the preset "none"."""
    if preset == "none":
        raise UserError("zoo has its own preset: to train without one, name the algorithm")
    first, *others = map(recipe, tasks)
    for name, other in zip(tasks[1:], others, strict=True):
        if other[:2] != first[:2]:
            raise UserError(f"the zoo trains {tasks[0]} and {name} differently: train them apart")
    return first.algorithm, "zoo", first.steps


def configs_of(
    algorithm: str,
    task: str | Iterable[str],
    hyperparameters: Sequence[Any],
    preset: PresetName,
    backend: Backend,
    given: Mapping[str, Any],
) -> list[TrainConfig]:
    """Return a configuration for each choice of hyper-parameters.

    hyperparameters: each a mapping of values that replace the preset's, or an object of the
    algorithm's config class. given: settings, from `settings_of`. Raises UserError for invalid
    settings, and for those that this machine does not support."""
    tasks = ids_of(task)
    settings = dict(given)
    if settings.get("steps") is None:
        settings["steps"] = TrainConfig.steps
    parameters = settings.get("task_parameters")
    settings["task_parameters"] = (
        dict(parameters) if isinstance(parameters, Mapping) else parameters
    )
    if parameters is None:
        del settings["task_parameters"]
    settings |= {"algorithm": algorithm, "tasks": tasks, "backend": backend}
    every = [_hyperparameters(algorithm, tasks, own, preset) for own in hyperparameters]
    configs = [TrainConfig(**settings, hyperparameters=own) for own in every]
    first = configs[0]
    if first.step_timeout is not None and first.vectorization != "async":
        word = first.vectorization
        raise UserError(f"step_timeout is for processes: vectorization must be async, got {word}")
    for name in tasks:
        check_task(name, first.task_parameters, first.task_costs)
    if first.tensorboard:
        extra("tensorboard", "tensorboard")
    chosen, why = lockstep_backend.choose(backend)
    if why:
        warnings.warn(why, stacklevel=4)
    if chosen == backend:
        return configs
    return [dataclasses.replace(config, backend=chosen) for config in configs]


def _hyperparameters(algorithm: str, tasks: Sequence[str], own: Any, preset: PresetName) -> Any:
    """Return the hyper-parameters for all tasks. Raises UserError if the tasks' presets differ."""
    if not isinstance(own, Mapping):
        return own
    presets = {name: preset_with(algorithm, name, own, preset) for name in tasks}
    first, chosen = next(iter(presets.items()))
    for name, other in presets.items():
        if other != chosen:
            raise UserError(
                f"{first} and {name} have different presets for {algorithm}, {chosen} and {other}: "
                "train them in folders of their own, or give the hyper-parameters in which they "
                "differ"
            )
    return chosen


def combinations_of(values: Mapping[str, Values]) -> dict[str, dict[str, Any]]:
    """Return every combination by its folder's name, such as "cost_limit=5.0,hidden=64x64"; a name
    too long for a folder is cut, with a digest at the end.

    Raises UserError for an empty grid, for values that are not collections, and for equal names.
    """
    if not isinstance(values, Mapping):
        raise UserError(f"grid must be values by the names of hyper-parameters, got {values!r}")
    for name, several in values.items():
        if isinstance(several, str) or not isinstance(several, Collection) or not len(several):
            raise UserError(f"grid needs several values of {name}, got {several!r}")
    if not values:
        raise UserError("grid is empty: it needs values of at least one hyper-parameter")
    combinations: dict[str, dict[str, Any]] = {}
    for chosen in itertools.product(*values.values()):
        combination = dict(zip(values, chosen, strict=True))
        name = _short(",".join(f"{key}={_word(value)}" for key, value in combination.items()))
        if name in combinations:
            raise UserError(f"grid has {name} twice")
        combinations[name] = combination
    return combinations


LONGEST_NAME = 200
"""Most bytes of a folder's name; file systems allow 255, and unfinished files have longer names."""


def _short(name: str) -> str:
    """Shorten a name to at most `LONGEST_NAME` bytes; different names stay different."""
    if len(name.encode()) <= LONGEST_NAME:
        return name
    digest = hashlib.blake2b(name.encode(), digest_size=8).hexdigest()
    return name.encode()[: LONGEST_NAME - 17].decode(errors="ignore") + "-" + digest


def _word(value: Any) -> str:
    parts = value if isinstance(value, (tuple, list)) else [value]
    return re.sub(r"[^\w.+-]+", "_", "x".join(map(str, parts)))


def _launch(
    configs: Mapping[Path, TrainConfig],
    engine: EngineName,
    workers: int | None,
    address: str | None,
    split: bool,
) -> list[Path]:
    """Train all unfinished folders to the end. Returns the folders of the runs.

    split: whether trainings may be split over several folders. Raises UserError if a folder holds
    other runs, and, after all others are done, if every run failed or a training ended early.
    """
    from agents.training import grid as grids
    from agents.training.launcher import launcher

    modules = modules_of(configs.values())
    with launcher(engine, workers, modules, address) as trainings:
        if split:
            configs = grids.split(configs, trainings.count)
        grids.prepare(configs)
        for folder in configs:
            if not finished(folder):
                trainings.submit(folder)
        trainings.wait(every=0.5)
        failed = trainings.failed
    # `_warn_of_failures` tells of single runs, as long as others are complete.
    if any(map(_has_complete_runs, configs, configs.values())):
        failed = {folder: why for folder, why in failed.items() if not finished(folder)}
    if failed:
        raise RunsFailed("; ".join(f"{folder} failed: {why}" for folder, why in failed.items()))
    return list(configs)


def _has_complete_runs(folder: Path, config: TrainConfig) -> bool:
    """Whether a training is finished, and not all of its runs failed."""
    return finished(folder) and len(list(failed_runs(folder, config))) < len(config.runs)


def modules_of(configs: Collection[TrainConfig]) -> list[str]:
    """Return the modules that other processes must import to register algorithms and tasks. Raises
    UserError for an algorithm or task registered in the running script: they cannot import it."""
    modules = {}
    for config in configs:
        if config.algorithm not in BUILT_IN:
            modules[module_of(config.algorithm)] = config.algorithm, "agents.register"
        for task in config.tasks:
            if module := module_of_task(task):
                modules[module] = task, "gymnasium.register"
    if "__main__" in modules:
        name, how = modules["__main__"]
        raise UserError(
            f"{name} is registered in the running script, which the processes that train cannot "
            f"import: call {how} in a separate module and import that"
        )
    return sorted(modules)


def _to_write(out: Folder) -> Path:
    """Return the folder to write to as an absolute path, since a task may change the current one.
    Raises UserError for anything that cannot be a folder."""
    if not isinstance(out, (str, os.PathLike)) or not os.fspath(out):
        raise UserError(f"out must be a folder, got {out!r}")
    check_folder(Path(out))
    return Path(out).absolute()


def _warn_of_failures(runs: Runs, stacklevel: int = 3) -> None:
    """Warn about each failed run, with the traceback of the task's error."""
    for folder, config in zip(runs.folders, runs.configs, strict=True):
        if not finished(folder):  # stopped by on_epoch
            continue
        for run, why, trace in failed_runs(folder, config):
            words = f"{folder}: {run}: {why}\n{trace}".rstrip()
            warnings.warn(words, FailedRunWarning, stacklevel)


def _train(
    folder: Path, config: TrainConfig, on_epoch: OnEpoch | None, progress: bool
) -> trainer.Trainer:
    """Train a folder. Raises RunsFailed if every run failed."""
    with contextlib.ExitStack() as stack:
        own: list[trainer.Callback] = []
        if progress:
            own.append(stack.enter_context(callbacks.show_progress(config)))
        if on_epoch:
            own.append(callbacks.follower(on_epoch))
        trained = trainer.train(folder, *own, config=config)
    if (trained.failures != "").all():
        trace = next(filter(None, trained.tracebacks), "")
        words = f"every run of {folder} failed; the first {trained.failures[0]}"
        raise RunsFailed(words) from (trained.cause or (RemoteTraceback(trace) if trace else None))
    return trained
