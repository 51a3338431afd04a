"""Numbers of an epoch, for those who follow a training: trackers, tuners, notebooks."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from agents.errors import UserError
from agents.training.loop import OnEpoch, Training


@dataclass(frozen=True)
class Epoch:
    """An epoch of the runs of one folder.

    `runs[seed]` has, for each run that took part, "step": environment steps taken; "return" and
    "cost" (undiscounted) and "length": means over the epoch's episodes; "mcc": the greatest share
    of an episode in one streak of cost; then the mean of each number that the algorithm's updates
    give, such as "critic_loss", where the run learned.
    """

    folder: Path
    algorithm: str
    task: str
    steps: int
    """Environment steps that each run takes in all."""
    runs: Mapping[int, Mapping[str, float]]
    """Numbers by seed and name: see above."""


def follower(on_epoch: Callable[[Epoch], object], folders: Sequence[Path]) -> OnEpoch:
    """The training loop's own callback for a function of an `Epoch`, called once a folder.

    folders: in the order of the trainings. The result is False, which stops them all, where the
    function returned False for any, be it numpy's; what else it returns does not matter.
    """
    seen: dict[Path, int] = {}

    def call(trainings: Sequence[Training]) -> bool:
        answers = []
        for folder, training in zip(folders, trainings, strict=True):
            took_part = seen.get(folder, 0) < training.epochs_here
            seen[folder] = training.epochs_here
            if took_part:
                answers.append(on_epoch(_epoch(folder, training)))
        return not any(isinstance(of, (bool, np.bool_)) and not of for of in answers)

    return call


def check_callback(on_epoch: object) -> None:
    """Raise UserError for an `on_epoch` that cannot be called."""
    if on_epoch is not None and not callable(on_epoch):
        raise UserError(f"on_epoch must be a function of an Epoch, got {on_epoch!r}")


def _epoch(folder: Path, training: Training) -> Epoch:
    config, numbers = training.config, training.log.latest_numbers()
    runs = {
        seed: {"step": float(step), **of_run}
        for seed, step, of_run in zip(config.seeds, training.steps, numbers, strict=True)
        if of_run
    }
    return Epoch(folder, config.algorithm, config.task, config.steps, runs)
