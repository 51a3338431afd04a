"""The training loop, which can be killed at any moment and goes on from its last checkpoint."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from agents.algorithms import learner
from agents.errors import UserError
from agents.lockstep import backend, tree
from agents.lockstep.noise import Purpose, environment_seeds, steps_of_noise
from agents.lockstep.rollout import collect
from agents.runs.config import TrainConfig, run_folder
from agents.runs.evaluate import evaluate
from agents.runs.files import locked, read_arrays, write_arrays
from agents.runs.log import Log
from agents.runs.tasks import make_envs, sizes

EVALUATION_EPISODES = 100


class Training:
    """The runs of one folder, between two epochs."""

    def __init__(self, config: TrainConfig) -> None:
        self.config = config
        self._envs = make_envs(config.task, len(config.seeds), config.task_parameters)
        self.learner = learner(
            config.algorithm, config.hyperparameters, config.seeds, *sizes(self._envs)
        )
        self.log = Log(self.learner.METRICS, len(config.seeds))
        self.epoch = 0
        self.steps = np.zeros(len(config.seeds), dtype=np.int64)
        """Environment steps each run has taken, [R]."""

    @property
    def done(self) -> bool:
        """Whether every run has taken its steps."""
        return bool((self.steps >= self.config.steps).all())

    def run_epoch(self) -> None:
        """Collect one episode of every run and learn from it."""
        seeds, action_size = self.config.seeds, self._envs.single_action_space.shape[0]  # pyright: ignore[reportOptionalSubscript]
        active = self.steps < self.config.steps
        policy, random_steps = self.learner.policy(), self.learner.random_steps
        noise = steps_of_noise(seeds, Purpose.EXPLORATION, self.epoch, (action_size,))
        step = self.steps.copy()

        def act(observation):
            normal, uniform = next(noise)
            at_random = step < random_steps
            step[:] += 1
            if at_random.all():
                return uniform
            action = policy(observation[:, None], normal[:, None])[:, 0]
            return np.where(at_random[:, None], uniform, action) if at_random.any() else action

        resets = environment_seeds(seeds, Purpose.ENVIRONMENT, self.epoch, 1)
        rollout = collect(self._envs, resets, act)
        metrics = self.learner.learn(rollout, self.epoch, active)
        self.log.add(rollout, np.where(active, self.steps, -1), metrics)
        self.steps += np.where(active, rollout.length, 0)
        self.epoch += 1

    def save(self, folder: Path) -> None:
        """Write the records, then the checkpoint from which all of it can be written again."""
        self.log.write([run_folder(folder, seed) for seed in self.config.seeds])
        counters = {"epoch": np.array(self.epoch), "seeds": np.array(self.config.seeds)}
        counters |= {"steps": self.steps, "log": self.log.table()}
        write_arrays(folder / "checkpoint.npz", counters | self.learner.state())

    def restore(self, folder: Path) -> None:
        """Take over a checkpoint. Raises UserError where it is missing or damaged."""
        path = folder / "checkpoint.npz"
        state = read_arrays(path)
        try:
            seeds = tree.expect("seeds", state, self.steps.shape, np.int64)
            if tuple(seeds) != self.config.seeds:
                raise ValueError(f"its seeds are {seeds.tolist()}")
            epoch = int(tree.expect("epoch", state, (), np.int64))
            log = tree.expect("log", state, (epoch, *self.log.table().shape[1:]), np.float64)
            self.epoch, self.steps = epoch, tree.expect("steps", state, self.steps.shape, np.int64)
            self.log.restore(log)
            self.learner.restore(state)
        except (KeyError, ValueError) as error:
            raise UserError(f"{path} is damaged or of another version: {error}") from None


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
    every = training.config.checkpoint_every
    while not training.done:
        before = training.steps.max() // every
        training.run_epoch()
        if training.done or training.steps.max() // every > before:
            training.save(folder)
        on_epoch(training)
    evaluate(folder, training.config, training.learner.policy(), EVALUATION_EPISODES)
    return training
