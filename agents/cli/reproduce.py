"""`circle2d reproduce`: run the paper's experiments and report."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from rich.console import Console
from rich.live import Live
from rich.table import Table

from agents.algorithms import ALGORITHMS
from agents.cli.checks import check_enough_steps, check_width
from agents.cli.options import BackendChoice, Imports, parse
from agents.errors import UserError, one_line
from agents.lockstep import backend as lockstep_backend
from agents.paper import grid
from agents.paper.presets import PAPER_ALGORITHMS
from agents.reporting.report import report
from agents.reporting.table import show
from agents.sweeps import modules_of
from agents.training.config import Device, TrainConfig
from agents.training.engines import Engine, EngineName, engine
from agents.training.environments import check_task, task_id
from agents.training.files import check_folder, locked
from agents.training.machine import other_session
from agents.training.progress import working
from agents.training.status import duration, share_done, speed
from agents.training.workers import MOST_WORKERS, Group
from circle2d_mj.circle2d.config import LEVELS


@dataclass(frozen=True)
class ReproduceOptions:
    """Run the paper's experiments, or a part of them, and write the report.

    Given again, the same command goes on where it was interrupted.
    """

    out: Path
    """Folder for the runs and the report."""
    quick: bool = False
    """A small version of everything: 2 seeds of 10 000 steps."""
    algorithms: tuple[str, ...] = PAPER_ALGORITHMS
    """Algorithms to run."""
    levels: tuple[int, ...] = LEVELS
    """Levels of Circle2D."""
    mujoco: bool = False
    """Run Circle2D with MuJoCo's physics instead of the kinematic mode."""
    tasks: tuple[str, ...] = ()
    """Ids of other tasks to run instead, such as circle2d_mj/SafetyPointGoal1-v0."""
    ablations: bool = False
    """Also run other values of settings that the paper does not print: TRPO-Lag's multiplier
    optimiser, bootstrapping at the time limit off-policy, observations in units of length, and
    WCSAC as in a later library. For SAC-LB-Streak, leave out one part at a time."""
    seeds: tuple[int, ...] | None = None
    """Seeds of each algorithm and task; by default 0 1 2."""
    steps: int | None = None
    """Environment steps of each run; by default the paper's: 1 000 000 on Circle2D, 10 000 000 on
    its Safety tasks."""
    backend: BackendChoice | None = None
    """How updates run: see `circle2d train --help`. By default the backend that the runs in out
    began with, else auto; with --quick eager, since it ends before updates would be compiled."""
    device: Device = "cpu"
    """Where updates run: cuda on a GPU."""
    workers: int | None = None
    """Processes, of one thread each, or tasks of Ray at a time; by default one for each core that
    this process may use, or that the Ray cluster has."""
    engine: EngineName = "local"
    """local: processes of this machine. ray: tasks of a Ray cluster, of one core each (and one GPU
    with --device cuda); needs the extra [ray]."""
    address: str | None = None
    """Of the Ray cluster's head, HOST:PORT, or auto for one that runs on this machine; by default
    RAY_ADDRESS, or else a cluster of this machine is started."""
    shard: str | None = None
    """I/N, such as 1/4: train the I-th of N equal parts, for job arrays. Writes no report."""
    width: int | None = None
    """Characters of a line that tables fit; by default the terminal's. Into a file or a pipe they
    are printed as Markdown."""
    imports: Imports = ()


def run(args: Sequence[str]) -> int:
    """Run `circle2d reproduce`; returns the exit status."""
    options = parse(ReproduceOptions, "reproduce", args)
    check_width(options.width)
    check_folder(options.out)
    if not options.algorithms:
        raise UserError(f"algorithms must be some of {', '.join(ALGORITHMS)}, got none")
    if options.workers is not None and not 1 <= options.workers <= MOST_WORKERS:
        raise UserError(f"workers must be in [1, {MOST_WORKERS}], got {options.workers}")
    configs = _configs(options)
    if options.shard is not None:
        configs = grid.shard(configs, *_shard(options.shard))
    # The engine first: one that refuses leaves no folder behind.
    with engine(options.engine, options.workers, options.address, options.device) as ready:
        failed = _train_in(configs, options, ready)
    for folder, message in failed.items():
        print(f"circle2d: {one_line(folder)} failed: {one_line(message)}", file=sys.stderr)
    if options.shard is not None:
        print(f"part {options.shard} is over; after all: circle2d report {options.out}")
        return int(bool(failed))
    try:
        with working("drawing the report"):
            blocks = report(options.out).blocks
        show(blocks, options.width)
    except UserError as error:
        print(f"circle2d: no report: {one_line(error)}", file=sys.stderr)
        return 1
    return int(bool(failed) or any(grid.has_failures(f, c) for f, c in configs.items()))


def _train_in(
    configs: dict[Path, TrainConfig], options: ReproduceOptions, engine: Engine
) -> dict[Path, str]:
    """Make the folders and train in them; returns those that failed, each with its error."""
    grid.prepare(configs)
    for folder, config in configs.items():
        if (note := other_session(folder)) and not grid.finished(folder, config):
            print(f"circle2d: {folder}: {note}", file=sys.stderr)
    modules = dict.fromkeys([*options.imports, *modules_of(configs.values())])
    # The parts of a grid train at the same time: there each folder has a lock alone.
    with contextlib.nullcontext() if options.shard else locked(options.out):
        return _train(configs, engine, [*modules])


def _configs(options: ReproduceOptions) -> dict[Path, TrainConfig]:
    """The grid's folders and what is trained in them."""
    tasks = [task_id(task) for task in _tasks(options)]
    for task in tasks:
        check_task(task, {})
    seeds, steps = options.seeds, options.steps
    if seeds is None:
        seeds = grid.QUICK_SEEDS if options.quick else grid.SEEDS
    if steps is None and options.quick:
        steps = grid.QUICK_STEPS
    what = (tasks, options.algorithms, seeds, steps, options.device, options.ablations)
    configs = grid.grid(options.out, *what)
    for config in configs.values():
        check_enough_steps(config.task, {}, config.steps, config.hyperparameters)
    usual = "eager" if options.quick else grid.backend_of(configs) or "auto"
    backend = lockstep_backend.choose(options.backend or usual)
    lockstep_backend.require(backend == "compiled", options.device)
    return {folder: replace(config, backend=backend) for folder, config in configs.items()}


def _shard(text: str) -> tuple[int, int]:
    """I and N of "I/N". Raises UserError."""
    part, _, count = text.partition("/")
    if not (part.isdecimal() and count.isdecimal() and 1 <= int(part) <= int(count)):
        raise UserError(f"shard must be I/N with I from 1 to N, such as 1/4, got {text!r}")
    return int(part), int(count)


def _tasks(options: ReproduceOptions) -> Sequence[str]:
    if not options.tasks:
        return grid.circle2d_tasks(options.levels, options.mujoco)
    if options.mujoco or options.levels != LEVELS:
        raise UserError("give either tasks, or levels and mujoco, which choose tasks of Circle2D")
    if options.quick and options.steps is None:
        raise UserError("quick is of Circle2D: give steps as well for other tasks")
    return options.tasks


def _train(
    configs: dict[Path, TrainConfig], engine: Engine, imports: Sequence[str]
) -> dict[Path, str]:
    """Train what is not finished; returns the folders that failed, each with its error."""
    left = [folder for folder, config in configs.items() if not grid.finished(folder, config)]
    shares = {folder: share_done(folder) if folder in left else 1.0 for folder in configs}
    started, (before, total) = time.monotonic(), grid.work_left(shares, configs)
    console = Console(stderr=True)
    groups = grid.groups({folder: configs[folder] for folder in left}, engine.count)

    def is_finished(folder: Path) -> bool:
        return grid.finished(folder, configs[folder])

    with (
        engine.workers(groups, is_finished, imports) as workers,
        Live(console=console, auto_refresh=False) as live,
    ):
        shown, tenths = 0, 0

        def show() -> None:
            nonlocal shown, tenths
            for folder in left:
                shares[folder] = 1.0 if folder in workers.over else share_done(folder)
            done, _ = grid.work_left(shares, configs)
            seconds = time.monotonic() - started
            left_of_all = grid.seconds_left(seconds, before, done, total)
            headline = _headline(workers.running, shares, done / total, left_of_all)
            if console.is_terminal:
                live.update(_table(headline, workers.running, shares), refresh=True)
                return
            for folder in workers.over[shown:]:
                how = "failed" if folder in workers.failed else "done"
                print(f"{folder}: {how} after {seconds:.0f} s", file=sys.stderr, flush=True)
            shown = len(workers.over)
            if int(10 * done / total) > tenths:
                tenths = int(10 * done / total)
                print(headline, file=sys.stderr, flush=True)

        workers.run(show)
        return {
            folder: message
            for folder, message in workers.failed.items()
            # Of a group one run may have failed, and the other folders be done.
            if grid.has_failures(folder, configs[folder])
            or not grid.finished(folder, configs[folder])
        }


def _headline(
    running: Sequence[Group], shares: dict[Path, float], done: float, seconds_left: float | None
) -> str:
    """Progress, time left and speed of all trainings."""
    over = sum(share == 1.0 for share in shares.values())
    left = "" if seconds_left is None else f", {duration(seconds_left)} left"
    in_all = sum(filter(None, (speed(group[0]) for group in running)))
    return (
        f"{100 * done:.0f} % done, {over} of {len(shares)} trainings{left}, "
        f"{in_all:,.0f} steps/s in all"
    )


def _table(headline: str, running: Sequence[Group], shares: dict[Path, float]) -> Table:
    """A row for each group that is trained now."""
    table = Table(title=headline)
    table.add_column("training")
    table.add_column("done", justify="right")
    table.add_column("steps/s", justify="right")
    for group in running:
        of_group = speed(group[0])
        words = "" if of_group is None else f"{of_group:,.0f}"
        names = "\n".join(map(str, group))
        table.add_row(names, f"{100 * shares[group[0]]:.0f} %", words)
    return table
