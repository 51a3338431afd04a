"""`circle2d train`, `resume`, `grid` and `reproduce`: commands that train."""

from __future__ import annotations

import contextlib
import dataclasses
import sys
import time
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console
from rich.markup import escape

from agents import api
from agents.algorithms import ALGORITHMS
from agents.checks import Settings
from agents.cli.main import AfterEpoch, say
from agents.cli.options import (
    Folders,
    Imports,
    Width,
    import_modules,
    literals,
    parse,
    split_options,
    values_of,
)
from agents.errors import OwnCodeError, UserError, traced
from agents.lockstep import backend as lockstep_backend
from agents.lockstep.kernel import Backend
from agents.presets import PresetName, preset, preset_with, with_hyperparameter
from agents.reporting.report import report, table
from agents.reporting.table import show, working
from agents.runs import Runs
from agents.studies import used_study
from agents.training import callbacks, derive
from agents.training import grid as grid_of
from agents.training.callbacks import duration, share_done
from agents.training.config import TrainConfig, finished
from agents.training.environments import Vectorization, check_task, task_id
from agents.training.files import archive_of, check_folder, locked
from agents.training.launcher import EngineName, Launcher, launcher
from circle2d_mj.circle2d.config import LEVELS


@dataclass(frozen=True)
class TrainOptions:
    """Train runs of an algorithm, one for each task and seed, in lockstep."""

    out: Path
    """Folder for the runs; created, and refused if it already holds runs."""
    task: tuple[str, ...] = ("Circle2D-1-v0",)
    """Ids of gymnasium tasks with info["cost"]; an id without a version means the newest one."""
    seeds: tuple[int, ...] = TrainConfig.seeds
    """A run on each task for each seed."""
    steps: int | None = None
    """Environment steps of each run, rounded up to whole epochs; by default 1 000 000, for zoo as
    many as its runs had."""
    checkpoint_every: int = TrainConfig.checkpoint_every
    """Environment steps of a run between checkpoints, from which a killed run continues; more if
    writing them would take more than 2 % of the time."""
    evaluate_every: int | None = TrainConfig.evaluate_every
    """Environment steps of a run between evaluations over 20 episodes of each policy; each
    evaluation also saves the policy (see `Runs.to_pandas`). By default only the end is
    evaluated."""
    evaluation_episodes: int = TrainConfig.evaluation_episodes
    """Episodes of each run and policy (deterministic, stochastic) in the evaluation at the end."""
    task_parameters: dict[str, str] = field(default_factory=dict)
    """Keyword arguments for the tasks, as NAME VALUE ..., e.g. optima_perturbation "(1.0, 0.5)"."""
    costs: tuple[str, ...] = TrainConfig.costs
    """Names of costs in the tasks' info: all are recorded; an algorithm limits the first one, or as
    many as it supports."""
    vectorization: Vectorization = TrainConfig.vectorization
    """How environments are vectorized. auto: the task's own vector environment, or gymnasium's
    SyncVectorEnv if it has none; sync: always SyncVectorEnv; async: a process for each environment,
    for slow tasks."""
    step_timeout: float | None = TrainConfig.step_timeout
    """Seconds that a step may take with async; if a process does not answer in time, the training
    fails. By default there is no limit."""
    tensorboard: bool = TrainConfig.tensorboard
    """Also write TensorBoard event files."""
    preset: PresetName = "paper"
    """Initial hyper-parameters. paper: the paper's values on its tasks and their families, the
    algorithm's defaults elsewhere; zoo: those of the agents that come with the package; none: the
    defaults everywhere."""
    backend: Backend = TrainConfig.backend
    """How networks are computed: in C++, compiled in two seconds the first time, or in NumPy, half
    as fast, which is also used, with a warning, if there is no C++ compiler."""
    imports: Imports = ()


def train(args: Sequence[str]) -> int:
    """Run `circle2d train ALGORITHM ...`; return the exit status."""
    import_modules(args)
    name = next((arg for arg in args[:1] if not arg.startswith("-")), None)
    if name is None:
        names = ", ".join(ALGORITHMS)
        if {"-h", "--help"} & set(args):
            print(f"usage: circle2d train ALGORITHM [OPTIONS]\n\nAlgorithms: {names}.\n")
            print("zoo: the algorithm and settings that 'circle2d zoo' lists for the task.")
            print("'circle2d train ALGORITHM --help' explains the options of an algorithm.")
            return 0
        raise UserError(f"train needs the algorithm first: one of {names}")
    tasks = [task_id(task) for task in values_of("--task", args)] or [*TrainOptions.task]
    named: Any = [TrainOptions.preset, *values_of("--preset", args, most=1)][-1]
    own, named, steps = api.of_zoo(tasks, named) if name == "zoo" else (name, named, None)
    hyperparameters = preset(own, tasks[0], named)
    for task in tasks[1:]:
        if preset(own, task, named) != hyperparameters:
            raise UserError(
                f"{tasks[0]} and {task} have different presets: train them separately, or with "
                "--preset none"
            )
    try:
        options = parse(_train_options(hyperparameters), f"train {name}", args[1:])
    except UserError:
        for option in (arg.removeprefix("--").replace("-", "_") for arg in args[1:]):
            if not hasattr(hyperparameters, option) and with_hyperparameter(option):
                preset_with(own, tasks[0], {option: None}, named)  # its error names who has it
        raise
    out = options.out.absolute()  # a task may change the current folder
    check_folder(out)
    given = api.settings_of(vars(options))
    given |= {
        "task_parameters": literals(options.task_parameters),
        "steps": steps if options.steps is None else options.steps,
    }
    chosen = [options.hyperparameters]
    (config,) = api.configs_of(own, options.task, chosen, named, options.backend, given)
    with AfterEpoch(options.imports) as after_epoch:
        runs = api.train_config(config, out, after_epoch, progress=True)
    return _finish(runs, after_epoch)


def _train_options(hyperparameters: Any) -> type:
    """Return `TrainOptions` extended by an algorithm's hyper-parameters, with the preset's values
    as defaults."""
    annotation = Annotated[type(hyperparameters), tyro.conf.OmitArgPrefixes]
    return dataclasses.make_dataclass(
        "TrainOptions",
        [("hyperparameters", annotation, field(default=hyperparameters))],
        bases=(TrainOptions,),
        frozen=True,
        namespace={"__doc__": TrainOptions.__doc__},
    )


def _finish(runs: Runs, after_epoch: AfterEpoch) -> int:
    """Print the table of every folder, and the failures; return the exit status.

    after_epoch: knows whether a signal stopped the training; then only one line is printed.
    """
    if after_epoch.number is not None:
        say(after_epoch.words())
        return 128 + after_epoch.number
    status = 0
    for folder in runs.folders:
        try:
            show(table(folder, used_study()), more=str(folder / "report.md"))
        except UserError as error:  # the training itself is done
            status = max(status, no_table(error, "table"))
    return max(status, name_failures(zip(runs.folders, runs.configs, strict=True)))


def no_table(error: UserError, what: str) -> int:
    """Print why there is no table or report, with the traceback of an error in the user's own code;
    return the exit status, which is 1 for an error in the user's own code."""
    print(traced(error.__cause__), end="", file=sys.stderr)
    say(f"no {what}: {error}")
    return int(isinstance(error, OwnCodeError))


def name_failures(folders: Iterable[tuple[Path, TrainConfig]]) -> int:
    """Print the runs that failed in training or evaluation; return the exit status."""
    status = 0
    for folder, config in folders:
        for run, why, trace in derive.failed_runs(folder, config):
            print(trace, end="", file=sys.stderr)
            say(f"{folder}: {run}: {why}")
            status = 1
    return status


@dataclass(frozen=True)
class ResumeOptions:
    """Continue interrupted runs from their newest checkpoint; the results are bit for bit those of
    runs that were never interrupted."""

    folders: Folders
    """Folders of runs, one after the other."""
    steps: int | None = None
    """A new, greater number of environment steps for each run: finished trainings continue too, bit
    for bit as if they had had that number from the start."""
    imports: Imports = ()


def resume(args: Sequence[str]) -> int:
    """Run `circle2d resume`; return the exit status."""
    options = parse(ResumeOptions, "resume", args)
    for folder in options.folders:
        TrainConfig.read(folder)
        if (note := callbacks.other_session(folder)) and not finished(folder):
            say(f"{folder}: {note}")
    done = [folder for folder in options.folders if finished(folder)]
    if options.steps is not None:
        done = [folder for folder in done if TrainConfig.read(folder).steps == options.steps]
    with AfterEpoch(options.imports) as after_epoch:
        runs = api.resume(
            *options.folders, steps=options.steps, progress=True, on_epoch=after_epoch
        )
    for folder in done:
        steps = TrainConfig.read(folder).steps
        say(f"{folder}: was done already, all {steps} steps; --steps N with a greater N continues")
    return _finish(runs, after_epoch)


@dataclass(frozen=True, kw_only=True)
class Spread:
    """Options of commands that train grids."""

    workers: int | None = None
    """Number of trainings at the same time, each with one thread; by default one for each core that
    this process may use, or that the Ray cluster has."""
    engine: EngineName = "local"
    """local: processes on this machine. ray: tasks on a Ray cluster, with one core each; needs the
    extra [ray]."""
    address: str | None = None
    """The Ray cluster's head, HOST:PORT, or auto for a cluster that runs on this machine; by
    default RAY_ADDRESS if set, else a new cluster is started on this machine."""
    shard: str | None = None
    """I/N, such as 1/4: train the I-th of N equal parts, for job arrays. Writes no report."""
    width: Width = None


@dataclass(frozen=True)
class GridOptions(Spread, TrainOptions, Settings):
    """Train several algorithms on several tasks, each with its preset, on all cores, and report.

    Options of algorithms, such as --cost-limit 10, apply to all of them; 'circle2d train ALGORITHM
    --help' explains them. Each algorithm and task has a folder, OUT/TASK/ALGORITHM. Given again,
    the same command continues where it was interrupted.
    """

    algorithms: Annotated[
        tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="ALGORITHM ...")
    ] = ()
    """Names of algorithms."""


def grid(args: Sequence[str]) -> int:
    """Run `circle2d grid`; return the exit status."""
    own, hyperparameters = split_options(GridOptions, args)
    options = parse(GridOptions, "grid", own)
    options = replace(options, out=options.out.absolute())  # a task may change the current folder
    check_folder(options.out)
    settings = api.settings_of(vars(options)) | hyperparameters
    settings["task_parameters"] = literals(options.task_parameters)
    configs = api.grid_configs(
        options.algorithms, options.task, options.out, options.preset, options.backend, settings
    )
    return _run(options, configs)


@dataclass(frozen=True)
class ReproduceOptions(Spread, Settings):
    """Run the paper's experiments, or a part of them, and write the report.

    Given again, the same command continues where it was interrupted.
    """

    out: Path
    """Folder for the runs and the report."""
    quick: bool = False
    """A small version of everything: 2 seeds of 10 000 steps; with --benchmark 30 000 steps on
    Safety tasks."""
    benchmark: bool = False
    """Run the benchmark instead: all algorithms on Circle2D and five Safety tasks, 1 000 000 steps
    each, with ten seeds on Circle2D (five for off-policy algorithms) and three elsewhere."""
    beside: tuple[Path, ...] = ()
    """Folders of runs or archives that the report shows too, such as published ones."""
    algorithms: tuple[str, ...] | None = None
    """Algorithms to run; by default the paper's five, with --benchmark all."""
    levels: tuple[int, ...] = LEVELS
    """Levels of Circle2D."""
    mujoco: bool = False
    """Run Circle2D with MuJoCo's physics instead of the kinematic mode."""
    safety: bool = False
    """Run the paper's Safety-Gymnasium tasks instead."""
    tasks: tuple[str, ...] = ()
    """Ids of other tasks to run instead, such as circle2d_mj/SafetyPointGoal1-v0."""
    task_parameters: dict[str, str] = field(default_factory=dict)
    """Keyword arguments for the tasks, as NAME VALUE ..., e.g. contact soft stiffness 200."""
    ablations: bool = False
    """Also run other values of settings that the paper does not specify: the optimiser of
    TRPO-Lag's multiplier, bootstrapping at the time limit in off-policy algorithms, observations in
    units of length, and WCSAC as in a later library. For SAC-LB-Streak, leave out each part."""
    seeds: tuple[int, ...] | None = None
    """Seeds of each algorithm and task; by default 0 1 2, with --quick 0 1, with --benchmark 3 to
    10."""
    steps: int | None = None
    """Environment steps of each run; by default the paper's: 1 000 000 on Circle2D, 10 000 000 on
    its Safety tasks; with --quick 10 000, with --benchmark 1 000 000."""
    backend: Backend | None = None
    """How networks are computed: see `circle2d train ALGORITHM --help`. By default the backend of
    the runs in out, else c++."""
    imports: Imports = ()


def reproduce(args: Sequence[str]) -> int:
    """Run `circle2d reproduce`; return the exit status."""
    options = parse(ReproduceOptions, "reproduce", args)
    options = replace(options, out=options.out.absolute())  # a task may change the current folder
    check_folder(options.out)
    for source in options.beside:
        if not source.exists() and archive_of(source) is None:
            raise UserError(f"beside {source}: there is no such folder or archive")
    configs = _configs(options)
    return _run(options, configs, options.beside)


def _run(
    options: ReproduceOptions | GridOptions,
    configs: Mapping[Path, TrainConfig],
    beside: Sequence[Path] = (),
) -> int:
    """Train a grid and report it, or train a shard of it; return the exit status."""
    out = options.out
    if options.shard is not None:
        part, count = _shard(options.shard)  # every shard splits the grid in the same way
        configs = grid_of.shard(grid_of.split(configs, count * (options.workers or 1)), part, count)
    modules = [*dict.fromkeys([*options.imports, *api.modules_of(configs.values())])]
    # Start the engine first: if it refuses, no folder is left behind.
    with launcher(options.engine, options.workers, modules, options.address) as trainings:
        if options.shard is None:
            configs = grid_of.split(configs, trainings.count)
        grid_of.prepare(configs)
        for folder in configs:
            if (note := callbacks.other_session(folder)) and not finished(folder):
                say(f"{folder}: {note}")
            if finished(folder) and any(derive.failed_runs(folder, configs[folder])):
                say(f"{folder}: holds runs that failed: remove it to train them again")
        # The shards of a grid train at the same time, so only their folders are locked, not `out`.
        with contextlib.nullcontext() if options.shard else locked(out):
            failed = _train_all(configs, trainings)
    for folder, why in failed.items():
        say(f"{folder} failed: {why}")
    if options.shard is not None:
        print(f"part {options.shard} is done; when all are: circle2d report {out}")
        return int(bool(failed))
    try:
        with working("drawing the report"):
            written = report(out, *beside, study=used_study(), out=out)
        show(written.blocks, options.width, str(written.page))
    except UserError as error:
        no_table(error, "report")
        return 1
    return int(bool(failed or written.left_out))


def _configs(options: ReproduceOptions) -> dict[Path, TrainConfig]:
    """Return the grid's trainings by folder."""
    from agents.paper import grid as papers

    names = options.algorithms
    if names is None:
        names = tuple(ALGORITHMS) if options.benchmark else papers.PAPER_ALGORITHMS
    if not names:
        raise UserError(f"algorithms must be among {', '.join(ALGORITHMS)}, got none")
    tasks = [task_id(task) for task in _tasks(options)]
    parameters = literals(options.task_parameters)
    for task in tasks:
        check_task(task, parameters)
    seeds, steps = options.seeds, options.steps
    if options.benchmark:
        configs = papers.benchmark(
            options.out, tasks, names, seeds, steps, options.quick, parameters
        )
    else:
        if seeds is None:
            seeds = papers.QUICK_SEEDS if options.quick else papers.SEEDS
        if steps is None and options.quick:
            steps = papers.QUICK_STEPS
        variants = papers.ablations if options.ablations else None
        configs = grid_of.grid(options.out, tasks, names, seeds, steps, parameters, variants)
    usual: Backend = "c++"
    if begun := next((f for f in configs if (f / "config.json").exists()), None):
        usual = TrainConfig.read(begun).backend
    backend, why = lockstep_backend.choose(options.backend or usual)
    if why:
        warnings.warn(why, stacklevel=2)
    return {folder: replace(config, backend=backend) for folder, config in configs.items()}


def _shard(text: str) -> tuple[int, int]:
    """Return I and N of "I/N". Raises UserError for any other text."""
    part, _, count = text.partition("/")
    if not (part.isdecimal() and count.isdecimal() and 1 <= int(part) <= int(count)):
        raise UserError(f"shard must be I/N with I from 1 to N, such as 1/4, got {text!r}")
    return int(part), int(count)


def _tasks(options: ReproduceOptions) -> Sequence[str]:
    from agents.paper import grid as papers

    others = options.safety + (options.mujoco or options.levels != LEVELS)
    if options.benchmark and (others or options.ablations):
        raise UserError("benchmark has its own tasks: to choose others, give tasks")
    if bool(options.tasks) + others > 1:
        raise UserError("give only one choice of tasks: tasks, safety, or levels and mujoco")
    if options.safety:
        return papers.SAFETY
    if options.benchmark:
        return options.tasks or papers.BENCHMARK
    if not options.tasks:
        return papers.circle2d_tasks(options.levels, options.mujoco)
    if options.quick and options.steps is None:
        raise UserError("quick is for Circle2D: for other tasks, give steps as well")
    return options.tasks


def _train_all(configs: Mapping[Path, TrainConfig], trainings: Launcher) -> dict[Path, str]:
    """Train the unfinished folders, showing progress; return the failed ones, and why."""
    left = [folder for folder in configs if not finished(folder)]
    if not left:  # some shards are empty if the grid has fewer trainings than shards
        return {}
    work = {folder: grid_of.work(config) for folder, config in configs.items()}
    for folder in left:
        trainings.submit(folder)

    def over(folder: Path) -> bool:
        return folder not in left or trainings.jobs[folder].done()

    def done() -> float:
        finished = sum(w * (1.0 if over(f) else share_done(f)) for f, w in work.items())
        return finished / sum(work.values())

    started, before, told = time.monotonic(), done(), set[Path]()
    console = Console(stderr=True)
    with console.status("") as status:

        def on_change() -> None:
            share, seconds = done(), time.monotonic() - started
            headline = f"{100 * share:.0f} % done, {sum(map(over, configs))} of {len(configs)} "
            headline += "trainings"
            if share > before:
                rest = seconds * (1 - share) / (share - before)
                headline += f", {duration(rest)} left"
            if console.is_terminal:
                status.update("\n".join([headline, *map(_progress, trainings.running)]))
                return
            for folder in (f for f in left if over(f) and f not in told):
                told.add(folder)
                how = "failed" if folder in trainings.failed else "done"
                words = f"{folder}: {how} after {seconds:.0f} s; {headline}"
                print(words, file=sys.stderr, flush=True)

        trainings.wait(on_change)
    return trainings.failed


def _progress(folder: Path) -> str:
    """Return a line on a running training."""
    speed = callbacks.speed(folder)
    per_second = "" if speed is None else f", {speed:,.0f} steps/s"
    return escape(f"{folder}: {100 * share_done(folder):.0f} %{per_second}")
