"""The training loop, which can be killed at any moment and goes on from its last checkpoint."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable
from pathlib import Path

import numpy as np
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from agents.algorithms import learner
from agents.errors import UserError
from agents.lockstep import backend, tree
from agents.lockstep.noise import Purpose, environment_seeds
from agents.lockstep.rollout import collect
from agents.runs.config import FAILURE, TrainConfig, run_folder
from agents.runs.evaluate import evaluate
from agents.runs.files import locked, read_arrays, write_arrays, write_json
from agents.runs.log import Log
from agents.runs.tasks import circle2d_config, make_envs, sizes
from agents.runs.tensorboard import Events
from agents.runs.visited import Visited

EVALUATION_EPISODES = 100


class Training:
    """The runs of one folder, between two epochs."""

    def __init__(self, config: TrainConfig) -> None:
        self.config = config
        runs = len(config.seeds)
        with contextlib.closing(make_envs(config.task, 1, config.task_parameters)) as one:
            sizes_of_one = sizes(one)
        self.learner = learner(
            config.algorithm, config.hyperparameters, config.seeds, *sizes_of_one
        )
        self.log = Log(runs, self.learner.episodes, self.learner.metrics)
        circle2d = circle2d_config(config.task, config.task_parameters)
        self.visited = Visited(circle2d, runs) if circle2d else None
        self.epoch = 0
        self.steps = np.zeros(runs, dtype=np.int64)
        """Environment steps each run has taken, [R]."""
        self.failed = np.zeros(runs, dtype=bool)
        """Runs that met a number which is not finite, [R]. They stop; the others go on."""

    @functools.cached_property
    def _envs(self) -> VectorEnv:
        """The environments of an epoch; made when they are first needed."""
        config, count = self.config, len(self.config.seeds) * self.learner.episodes
        return make_envs(config.task, count, config.task_parameters, config.vectorization)

    @property
    def active(self) -> NDArray[np.bool_]:
        """Runs that still have steps to take, [R]."""
        return (self.steps < self.config.steps) & ~self.failed

    @property
    def done(self) -> bool:
        """Whether no run has steps to take."""
        return not self.active.any()

    def run_epoch(self) -> None:
        """Collect the episodes of an epoch of every active run, and learn from them."""
        active, episodes, seeds = self.active, self.learner.episodes, self.config.seeds
        resets = environment_seeds(seeds, Purpose.ENVIRONMENT, self.epoch, episodes)
        act = self.learner.explorer(self.epoch, self.steps)
        rollout = collect(self._envs, resets, act, np.repeat(active, episodes))
        diverged = rollout.diverged.reshape(-1, episodes).any(axis=1)
        learning = active & ~diverged
        metrics = np.full((len(seeds), len(self.learner.metrics)), np.nan)
        if learning.any():
            metrics = self.learner.learn(rollout, self.epoch, learning)
        self.log.add(rollout, self.steps, learning, metrics)
        if self.visited:
            self.visited.add(rollout, learning)
        self.steps += np.where(active, rollout.length.reshape(-1, episodes).sum(axis=1), 0)
        self.failed |= active & (diverged | ~self.learner.finite())
        self.epoch += 1

    def save(self, folder: Path) -> None:
        """Write the records, then the checkpoint from which all of it can be written again."""
        folders = self._folders(folder)
        self.log.write(folders)
        if self.visited:
            self.visited.write(folders)
        for of_run, failed, steps in zip(folders, self.failed, self.steps, strict=True):
            (of_run / FAILURE).unlink(missing_ok=True)
            if failed:
                write_json(of_run / FAILURE, {"step": int(steps)})
        counters = {"epoch": np.array(self.epoch), "seeds": np.array(self.config.seeds)}
        counters |= {"steps": self.steps, "failed": self.failed}
        write_arrays(folder / "checkpoint.npz", counters | self.log.state() | self.learner.state())

    def restore(self, folder: Path) -> None:
        """Take over a checkpoint. Raises UserError where it is missing or damaged."""
        path = folder / "checkpoint.npz"
        state = read_arrays(path)
        try:
            seeds = tree.expect("seeds", state, self.steps.shape, np.int64)
            if tuple(seeds) != self.config.seeds:
                raise ValueError(f"its seeds are {seeds.tolist()}")
            self.epoch = int(tree.expect("epoch", state, (), np.int64))
            self.steps = tree.expect("steps", state, self.steps.shape, np.int64)
            self.failed = tree.expect("failed", state, self.failed.shape, np.bool_)
            self.log.restore(state, self.epoch)
            self.learner.restore(state)
        except (KeyError, ValueError) as error:
            raise UserError(f"{path} is damaged or of another version: {error}") from None
        if self.visited:
            self.visited.restore(self._folders(folder), self.log.steps)

    def _folders(self, folder: Path) -> list[Path]:
        return [run_folder(folder, seed) for seed in self.config.seeds]

    def close(self) -> None:
        """Let go of the environments."""
        if "_envs" in vars(self):
            self._envs.close()


def restored(folder: Path) -> Training:
    """The training of a folder as its last checkpoint left it."""
    training = Training(TrainConfig.read(folder))
    training.restore(folder)
    return training


def train(folder: Path, on_epoch: Callable[[Training], None] = lambda training: None) -> Training:
    """Train the runs of a folder to their end, from their last checkpoint if there is one.

    The folder is one that `TrainConfig.write` made. Settles torch's threads and products for the
    process (`backend.configure`); the last bits of results depend on them. Ends with an evaluation
    over 100 episodes. `on_epoch` is called after every epoch, to show progress.
    """
    backend.configure()
    config = TrainConfig.read(folder)
    with locked(folder):
        return _train(Training(config), folder, on_epoch)


def _train(training: Training, folder: Path, on_epoch: Callable[[Training], None]) -> Training:
    if (folder / "checkpoint.npz").exists():
        training.restore(folder)
    config, every = training.config, training.config.checkpoint_every
    with contextlib.ExitStack() as stack:
        stack.callback(training.close)
        events = None
        if config.tensorboard:
            folders = [run_folder(folder, seed) for seed in config.seeds]
            events = stack.enter_context(contextlib.closing(Events(folders, training.steps)))
        while not training.done:
            before = training.steps // every
            training.run_epoch()
            if events:
                events.write(training.log, training.steps)
            if training.done or (training.steps // every > before).any():
                training.save(folder)
            on_epoch(training)
    evaluate(folder, config, training.learner.policy(), EVALUATION_EPISODES, ~training.failed)
    return training
