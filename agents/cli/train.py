"""`circle2d train`: train runs of an algorithm on a task."""

from __future__ import annotations

import ast
import contextlib
import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro

from agents import api
from agents.algorithms import ALGORITHMS
from agents.cli import signals
from agents.cli.checks import check_enough_steps
from agents.cli.hyperparameters import explain_all
from agents.cli.options import (
    BackendChoice,
    Imports,
    check_arguments,
    import_modules,
    parse,
    read_ahead,
)
from agents.cli.outcome import finish
from agents.errors import UserError
from agents.paper.presets import preset
from agents.training.config import Device
from agents.training.environments import Vectorization, check_task, task_id


@dataclass(frozen=True)
class TrainOptions:
    """Train some runs, which differ in their seed only, in step with each other."""

    algorithm: str
    """Name of the algorithm; its hyper-parameters are the options further down."""
    out: Path
    """Folder that the runs are written to; made, and refused if it holds runs already."""
    task: str = "Circle2D-1-v0"
    """Id of a gymnasium task with info["cost"]; without its version the newest."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """One run for each seed."""
    steps: int = 1_000_000
    """Environment steps of each run, rounded up to whole epochs."""
    checkpoint_every: int = 50_000
    """Environment steps of a run between checkpoints, from which a killed run goes on."""
    evaluate_every: int | None = None
    """Environment steps of a run between evaluations, each of which leaves the policy too; by
    default there is none but that at the end."""
    task_parameters: dict[str, str] = field(default_factory=dict)
    """Keyword arguments for the task, as NAME VALUE ..., e.g. optima_perturbation 1.0 0.5."""
    vectorization: Vectorization = "auto"
    """How environments run side by side: the task's own vector environment or one process (auto),
    gymnasium's SyncVectorEnv (sync), a process each, for slow tasks (async)."""
    step_timeout: float | None = None
    """Seconds that a step may take with async; if a process does not answer in time, the training
    fails. By default there is no limit."""
    tensorboard: bool = False
    """Write TensorBoard event files too, into each run's folder."""
    backend: BackendChoice = "auto"
    """How updates run. compiled: twice as fast as eager, after a minute of compilation the first
    time and seconds from then on. eager: operation by operation. auto: compiled where there is a
    C++ compiler."""
    device: Device = "cpu"
    """Where updates run: cuda on a GPU."""
    imports: Imports = ()


def run(args: Sequence[str]) -> int:
    """Run `circle2d train`; returns the exit status."""
    import_modules(args)
    ahead = read_ahead(args, algorithm=None, task=TrainOptions.task)
    task = task_id(ahead.task or "")
    if ahead.algorithm is None:
        if {"-h", "--help"} & set(args):
            with contextlib.suppress(SystemExit):
                parse(TrainOptions, "train", ["--help"])
            print(explain_all(task), end="")
            return 0
        check_arguments(TrainOptions, "train", args)
        raise UserError(f"train needs --algorithm: one of {', '.join(ALGORITHMS)}")
    hyperparameters = preset(ahead.algorithm, task)
    elsewhere = dict(_options_of_others(ahead.algorithm))
    options = parse(_train_options(hyperparameters), "train", args, elsewhere)
    values = {f.name: getattr(options, f.name) for f in dataclasses.fields(TrainOptions)}
    del values["imports"]
    values["task"] = task
    values["task_parameters"] = {k: _literal(v) for k, v in options.task_parameters.items()}
    own = options.hyperparameters
    check_task(task, values["task_parameters"])
    check_enough_steps(task, values["task_parameters"], options.steps, own)
    values |= {f.name: getattr(own, f.name) for f in dataclasses.fields(own)}
    with signals.AfterEpoch(options.imports) as after_epoch:
        runs = api.train(**values, progress=True, on_epoch=after_epoch)
    return finish(runs, after_epoch)


def _options_of_others(name: str) -> Iterator[tuple[str, str]]:
    """Options of the other algorithms, and which algorithms have them."""
    of_option: dict[str, list[str]] = {}
    for other, algorithm in ALGORITHMS.items():
        for config_field in dataclasses.fields(algorithm.config):
            of_option.setdefault(f"--{config_field.name.replace('_', '-')}", []).append(other)
    for option, names in of_option.items():
        if name not in names:
            yield option, f"an option of {', '.join(names)}, not of {name}"


def _train_options(hyperparameters: Any) -> type:
    """`TrainOptions` and the hyper-parameters of an algorithm, with their preset as defaults."""
    annotation = Annotated[type(hyperparameters), tyro.conf.OmitArgPrefixes]
    return dataclasses.make_dataclass(
        "TrainOptions",
        [("hyperparameters", annotation, field(default=hyperparameters))],
        bases=(TrainOptions,),
        frozen=True,
        namespace={"__doc__": TrainOptions.__doc__},
    )


def _literal(text: str) -> Any:
    """A task parameter as Python reads it (3.0, True, (1, 0.5)), else the text itself."""
    try:
        return ast.literal_eval(text)
    except (ValueError, SyntaxError):
        return text
