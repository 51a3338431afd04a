"""The command `circle2d`: train, resume, evaluate, report; `cli_compare`, `cli_grid` and
`cli_pictures` hold the others."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro

from agents.algorithms import ALGORITHMS, algorithm
from agents.cli.compare import run_compare
from agents.cli.hyperparameters import explain_all
from agents.cli.options import BackendChoice, chosen_backend, parse
from agents.cli.pictures import run_heatmap, run_render, run_scene
from agents.cli.reproduce import run_reproduce
from agents.errors import UserError
from agents.paper.presets import preset
from agents.reporting.report import report, table
from agents.training.config import Device, TrainConfig, run_folder
from agents.training.environments import Vectorization, check_task
from agents.training.evaluation import EVALUATION_EPISODES
from agents.training.loop import Training, evaluate_checkpoint, train
from agents.training.machine import other_session
from agents.training.progress import show_progress, working
from agents.training.tensorboard import require_tensorboard

USAGE = f"""\
usage: circle2d COMMAND ...

  train      train runs of an algorithm on a task, evaluate them and print their table
  resume     go on with runs that were interrupted
  evaluate   play episodes with trained policies
  reproduce  run the paper's experiments, or a part of them, and report
  report     tables, training curves and heat maps of trained runs
  compare    two sets of runs side by side, with the differences
  heatmap    draw which states were visited in training
  render     draw episodes of a trained policy: PNG, GIF, MP4
  scene      print the MuJoCo scene of a task (MJCF)

circle2d COMMAND --help explains the options of a command.
Algorithms: {", ".join(ALGORITHMS)}.
"""


@dataclass(frozen=True)
class TrainOptions:
    """Train some runs, which differ in their seed only, in step with each other."""

    algorithm: str
    """Name of the algorithm; its hyper-parameters are the options further down."""
    out: Path
    """Folder that the runs are written to; made, and refused if it holds runs already."""
    task: str = "Circle2D-1-v0"
    """Id of a gymnasium task with info["cost"]."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """One run for each seed."""
    steps: int = 1_000_000
    """Environment steps of each run."""
    checkpoint_every: int = 50_000
    """Environment steps of a run between checkpoints, from which a killed run goes on."""
    task_parameters: dict[str, str] = field(default_factory=dict)
    """Keyword arguments for the task, as NAME VALUE ..., e.g. constraint_radius 3.0."""
    vectorization: Vectorization = "auto"
    """How environments run side by side: the task's own vector environment or one process (auto),
    gymnasium's SyncVectorEnv (sync), a process each, for slow tasks (async)."""
    tensorboard: bool = False
    """Write TensorBoard event files too, into each run's folder."""
    backend: BackendChoice = "auto"
    """How updates run: as compiled code, twice as fast once compiled, which takes a minute at
    first and seconds from then on (compiled); operation by operation (eager); compiled where there
    is a C++ compiler (auto)."""
    device: Device = "cpu"
    """Where updates run: cuda on a GPU."""


@dataclass(frozen=True)
class ResumeOptions:
    """Go on with interrupted runs from their last checkpoint; the results are bit for bit those of
    runs that were never interrupted."""

    folders: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Folder of the runs; several, which differ in task and seeds only, train together."""


@dataclass(frozen=True)
class EvaluateOptions:
    """Play episodes with the policies of a folder's last checkpoint and print their means."""

    folder: Annotated[Path, tyro.conf.Positional]
    """Folder of the runs."""
    episodes: int = EVALUATION_EPISODES
    """Episodes of each run and policy (deterministic, stochastic)."""


@dataclass(frozen=True)
class ReportOptions:
    """Print the table of trained runs beside the paper's; write report.md, report.csv,
    and index.html with training curves and heat maps as well."""

    folder: Annotated[Path, tyro.conf.Positional]
    """Folder of runs, or one with several such folders below it, or an archive."""
    archive: Path | None = None
    """File to pack all that the report needs into; `circle2d report FILE` writes it again."""
    out: Path | None = None
    """Folder for the report; by default that of the runs, or one beside an archive, of its name."""


def run_train(args: Sequence[str]) -> int:
    name, task = _algorithm_and_task(args)
    config = preset(name, task) if name else None
    if config is None and {"-h", "--help"} & set(args):
        with contextlib.suppress(SystemExit):
            parse(TrainOptions, "train", ["--help"])
        print(explain_all(task), end="")
        return 0
    options = parse(_train_options(config), "train", args)
    values = {f.name: getattr(options, f.name) for f in dataclasses.fields(TrainOptions)}
    folder, choice = values.pop("out"), values.pop("backend")
    values["task_parameters"] = {k: _literal(v) for k, v in values["task_parameters"].items()}
    config = TrainConfig(**values, hyperparameters=options.hyperparameters)
    check_task(config.task, config.task_parameters)  # before anything is written
    if config.tensorboard:
        require_tensorboard()
    # Last, since it may have to compile something, or something to say.
    dataclasses.replace(config, backend=chosen_backend(choice)).write(folder)
    return _train(folder)


def run_resume(args: Sequence[str]) -> int:
    folders = parse(ResumeOptions, "resume", args).folders
    if not folders:
        raise UserError("resume needs a folder of runs")
    for folder in folders:
        TrainConfig.read(folder)
    for folder in folders:
        if said := other_session(folder):
            print(f"circle2d: {folder}: {said}", file=sys.stderr)
    return _train(*folders)


def run_evaluate(args: Sequence[str]) -> int:
    options = parse(EvaluateOptions, "evaluate", args)
    with working(f"playing {options.episodes} episodes of each run, by either policy"):
        training, results = evaluate_checkpoint(options.folder, options.episodes)
    active = ~training.failed
    took = training.steps[active] if active.any() else training.steps
    steps = f"after {took.min()} of {training.config.steps} steps"
    print(f"{options.folder}, {steps}: means over {options.episodes} episodes")
    for name, of_runs in results.items():
        for seed, measures in zip(training.config.seeds, of_runs, strict=True):
            numbers = ", ".join(f"{k} {v:.2f}" for k, v in measures.items() if isinstance(v, float))
            print(f"seed {seed}, {name} policy: {numbers or 'no finite numbers'}")
    return _failures(options.folder, training)


def run_report(args: Sequence[str]) -> int:
    options = parse(ReportOptions, "report", args)
    with working("reading runs and drawing figures"):
        told = report(options.folder, options.archive, options.out)
    print(told)
    return 0


COMMANDS: dict[str, Callable[[Sequence[str]], int]] = {
    "train": run_train,
    "resume": run_resume,
    "evaluate": run_evaluate,
    "report": run_report,
    "compare": run_compare,
    "reproduce": run_reproduce,
    "heatmap": run_heatmap,
    "render": run_render,
    "scene": run_scene,
}


def main(args: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit status: 0 done, 1 a run failed, 2 a mistake of the user,
    130 interrupted."""
    args = sys.argv[1:] if args is None else args
    if not args or args[0] in ("-h", "--help"):
        print(USAGE, end="")
        return 0 if args else 2
    command = args[0]
    try:
        if command not in COMMANDS:
            raise UserError(f"unknown command {command!r}: valid are {', '.join(COMMANDS)}")
        return COMMANDS[command](args[1:])
    except UserError as error:
        print(f"circle2d: {error}", file=sys.stderr)
        return 2
    except (OSError, MemoryError) as error:
        print(f"circle2d: {error or 'out of memory'}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        how = "'circle2d resume' of a training, or the same 'circle2d reproduce', goes on"
        print(f"circle2d: interrupted; {how}", file=sys.stderr)
        return 130


def _train(*folders: Path) -> int:
    configs = {folder: TrainConfig.read(folder) for folder in folders}
    with show_progress(configs) as on_epoch:
        trainings = train(*configs, on_epoch=on_epoch)
    for folder in configs:
        try:
            print(table(folder))
        except UserError as error:  # the training itself is done
            print(f"circle2d: no table: {error}", file=sys.stderr)
    return max([_failures(*pair) for pair in zip(configs, trainings, strict=True)])


def _failures(folder: Path, training: Training) -> int:
    """Name the runs that failed, in training or evaluation; the exit status."""
    told = []
    for seed, failed, step in zip(
        training.config.seeds, training.failed, training.steps, strict=True
    ):
        if failed:
            told.append(f"seed {seed} failed at step {step}: it met a number that is not finite")
        elif not (run_folder(folder, seed) / "evaluation.json").exists():
            told.append(f"the evaluation of seed {seed} met a number that is not finite")
    for line in told:
        print(f"circle2d: {folder}: {line}", file=sys.stderr)
    return int(bool(told))


def _algorithm_and_task(args: Sequence[str]) -> tuple[str | None, str]:
    """Which hyper-parameters `train` takes, and for which task: read ahead of the rest."""
    ahead = argparse.ArgumentParser(add_help=False, exit_on_error=False, allow_abbrev=False)
    ahead.add_argument("--algorithm", nargs="?")
    ahead.add_argument("--task", nargs="?", default=TrainOptions.task)
    known, _ = ahead.parse_known_args(args)
    if known.algorithm is not None:
        algorithm(known.algorithm)
    return known.algorithm, known.task or ""


def _train_options(config: Any) -> type:
    """`TrainOptions` and the hyper-parameters of an algorithm, with their preset as defaults."""
    if config is None:
        return TrainOptions
    annotation = Annotated[type(config), tyro.conf.OmitArgPrefixes]
    return dataclasses.make_dataclass(
        "TrainOptions",
        [("hyperparameters", annotation, field(default=config))],
        bases=(TrainOptions,),
        frozen=True,
        namespace={"__doc__": TrainOptions.__doc__},
    )


def _literal(text: str) -> Any:
    """A task parameter as Python reads it (3.0, True, (1, 0.5)), else the text itself."""
    import ast

    try:
        return ast.literal_eval(text)
    except (ValueError, SyntaxError):
        return text


if __name__ == "__main__":
    sys.exit(main())
