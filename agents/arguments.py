"""The arguments of `agents.train` and its neighbours, checked before anything is written."""

from __future__ import annotations

import dataclasses
import operator
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from agents.errors import UserError
from agents.lockstep import backend as lockstep_backend
from agents.paper.presets import preset_with
from agents.training.config import Backend, TrainConfig
from agents.training.environments import check_task, task_id
from agents.training.files import check_folder
from agents.training.tensorboard import require_tensorboard


def configs_of(
    algorithm: str,
    task: str,
    seeds: int | Iterable[int],
    steps: int,
    task_parameters: Mapping[str, Any] | None,
    hyperparameters: Sequence[Mapping[str, Any]],
    backend: Backend | Literal["auto"],
    settings: Mapping[str, Any],
) -> list[TrainConfig]:
    """A configuration for each choice of hyper-parameters. Raises UserError for what is not
    allowed, or not possible on this machine."""
    task = task_id(task)
    found = [preset_with(algorithm, task, given) for given in hyperparameters]
    parameters = {} if task_parameters is None else task_parameters
    if isinstance(parameters, Mapping):
        parameters = dict(parameters)
    first = TrainConfig(algorithm, task, _seeds_of(seeds), steps, found[0], parameters, **settings)
    if first.step_timeout is not None and first.vectorization != "async":
        given = first.vectorization  # not in TrainConfig, since earlier folders may hold it
        raise UserError(f"step_timeout is for processes: vectorization must be async, got {given}")
    check_task(task, first.task_parameters)
    if first.tensorboard:
        require_tensorboard()
    lockstep_backend.require(False, first.device)  # before the compiler is tried, which takes long
    chosen = lockstep_backend.choose(backend)
    lockstep_backend.require(chosen == "compiled", first.device)
    return [dataclasses.replace(first, hyperparameters=own, backend=chosen) for own in found]


def folder_to_write(out: str | os.PathLike[str]) -> Path:
    """The folder to write to. Raises UserError for what is none."""
    if not isinstance(out, (str, os.PathLike)):
        raise UserError(f"out must be a folder, got {out!r}")
    check_folder(Path(out))
    return Path(out)


def _seeds_of(seeds: int | Iterable[int]) -> tuple[int, ...]:
    try:
        return tuple(operator.index(s) for s in (seeds if isinstance(seeds, Iterable) else [seeds]))
    except TypeError:
        raise UserError(f"seeds must be an integer or several, got {seeds!r}") from None
