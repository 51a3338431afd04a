"""The training loop. It can be killed at any moment and goes on from its last checkpoint.

The runs of several folders may train jointly: one learner then holds them all, which is faster, and
each folder's files stay those of a folder that trains alone, bit for bit.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from agents.errors import UserError
from agents.lockstep import backend
from agents.training.config import (
    CHECKPOINT,
    PREVIOUS,
    TrainConfig,
    read_spaces,
    run_folders,
)
from agents.training.evaluation import EVALUATION_EPISODES, Results, evaluate
from agents.training.files import locked, remove_leftovers
from agents.training.machine import note_session
from agents.training.snapshots import write_snapshots
from agents.training.state import Training, joint_trainings, run_epoch
from agents.training.status import StatusFiles
from agents.training.tensorboard import Events


def load_training(folder: Path) -> Training:
    """The training of a folder as its last checkpoint left it."""
    [training] = joint_trainings({folder: TrainConfig.read(folder)})
    training.load(folder)
    return training


OnEpoch = Callable[[Sequence[Training]], object]
"""Called after every epoch with all trainings that run jointly. Returning False stops them."""


def train(*folders: Path, on_epoch: OnEpoch = lambda trainings: None) -> list[Training]:
    """Train the runs of some folders to their end, from their last checkpoints if there are any.

    The folders are ones that `TrainConfig.write` made. Several train jointly: they differ in tasks
    and seeds only, and each is left as if it had trained alone. Changes torch's threads and matrix
    products for the process (`backend.configure`); the last bits of results depend on them. NumPy
    has one thread meanwhile: its idle threads spin, which made two trainings side by side on two
    cores nine times slower.

    Ends with an evaluation over 100 episodes. Where `on_epoch` returns False, the training stops
    after a checkpoint instead, from which it can be resumed. Raises UserError where folders cannot
    train together, or another process trains in one.
    """
    configs = {folder: TrainConfig.read(folder) for folder in folders}
    if len(configs) > 1:
        _check_together(configs)
    one = next(iter(configs.values()))
    backend.configure(one.backend == "compiled", one.device)
    with contextlib.ExitStack() as stack:
        stack.enter_context(threadpool_limits(1, user_api="blas"))
        for folder in configs:
            stack.enter_context(locked(folder))
            remove_leftovers(folder)
        trainings = joint_trainings(configs)
        _train(dict(zip(configs, trainings, strict=True)), on_epoch)
    return trainings


def _train(trainings: dict[Path, Training], on_epoch: OnEpoch) -> None:
    for folder, training in trainings.items():
        if any((folder / name).exists() for name in (CHECKPOINT, PREVIOUS)):
            training.load(folder)
            training.restore_records(folder)
        if not training.done:
            note_session(folder)
    with contextlib.ExitStack() as stack:
        events = {}
        for folder, training in trainings.items():
            stack.callback(training.close)
            if training.config.tensorboard:
                of_folder = Events(run_folders(folder, training.config), training.steps)
                events[folder] = stack.enter_context(contextlib.closing(of_folder))
        _run_epochs(trainings, events, on_epoch)
    for folder, training in trainings.items():
        if training.done:
            policy = training.learner.policy(training.runs)
            evaluate(folder, training.config, policy, EVALUATION_EPISODES, ~training.failed)


def _run_epochs(
    trainings: dict[Path, Training], events: dict[Path, Events], on_epoch: OnEpoch
) -> None:
    """Go on until all trainings are done or `on_epoch` returns False, and save them."""
    jointly = list(trainings.values())
    unfinished = {folder: t for folder, t in trainings.items() if not t.done}
    status = StatusFiles(list(unfinished), jointly[0].config.steps)
    stopped = False
    while unfinished and not stopped:
        before = {folder: training.steps.copy() for folder, training in unfinished.items()}
        run_epoch(jointly)
        saved = []
        for folder, training in unfinished.items():
            if events:
                events[folder].write(training.log, training.steps)
            write_snapshots(
                folder,
                training.config,
                training.learner,
                training.runs,
                training.failed,
                before[folder],
                training.steps,
            )
            every = training.config.checkpoint_every
            if training.done or (training.steps // every > before[folder] // every).any():
                training.save(folder)
                saved.append(folder)
        status.update(jointly, last=all(training.done for training in jointly))
        stopped = on_epoch(jointly) is False
        if stopped:
            for folder in unfinished.keys() - saved:
                trainings[folder].save(folder)
            status.update(jointly, last=True)
        unfinished = {folder: t for folder, t in unfinished.items() if not t.done}


def _check_together(configs: dict[Path, TrainConfig]) -> None:
    """Raise UserError where folders cannot train together."""
    found: dict[str, tuple[Path, Any]] = {}
    for folder, config in configs.items():
        sizes = read_spaces(folder, config).sizes
        of_task = dict(zip(("observation size", "action size"), sizes, strict=True))
        for name, value in (config.shared | of_task).items():
            first, expected = found.setdefault(name, (folder, value))
            if value != expected:
                raise UserError(
                    f"folders that train together must have equal settings: {name} is {expected} "
                    f"in {first}, {value} in {folder}"
                )


def evaluate_checkpoint(folder: Path, episodes: int) -> tuple[Training, Results]:
    """Evaluate the policies of a folder's last checkpoint; write and return the results.

    Nothing trains in the folder meanwhile, so an evaluation never replaces that of a newer policy.
    Raises UserError where another process trains there.
    """
    TrainConfig.read(folder)  # before the lock makes a file in any folder
    with locked(folder):
        training = load_training(folder)
        active = ~training.failed
        policy = training.learner.policy()
        return training, evaluate(folder, training.config, policy, episodes, active)
