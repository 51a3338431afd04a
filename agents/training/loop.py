"""The training loop, which can be killed at any moment and goes on from its last checkpoint.

A folder's runs may train among those of other folders: one learner then holds them all, which is
faster, and each folder's files stay those of a folder that trains alone, bit for bit.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from agents.algorithms import learner as make_learner
from agents.errors import UserError
from agents.lockstep import backend, tree
from agents.lockstep.learner import Learner
from agents.lockstep.noise import Purpose, environment_seeds
from agents.lockstep.rollout import Rollout, collect
from agents.training.config import FAILURE, TrainConfig, check_together, run_folders
from agents.training.environments import circle2d_config, make_envs, sizes_of
from agents.training.evaluation import evaluate
from agents.training.files import locked, read_arrays, write_arrays, write_json
from agents.training.machine import note_session
from agents.training.records import Log
from agents.training.side_by_side import SideBySide
from agents.training.status import StatusFiles
from agents.training.step_files import StepFiles
from agents.training.tensorboard import Events

EVALUATION_EPISODES = 100


class Training:
    """The runs of one folder, between two epochs."""

    def __init__(
        self, config: TrainConfig, learner: Learner | None = None, first_run: int = 0
    ) -> None:
        """learner: one that holds runs of other folders too, and these from `first_run` on; by
        default it is made, for these alone."""
        self.config = config
        runs = len(config.seeds)
        self.learner = _learner_of([config]) if learner is None else learner
        self.runs = slice(first_run, first_run + runs)
        """Which runs of the learner these are."""
        self.log = Log(runs, self.learner.episodes, self.learner.metrics)
        circle2d = circle2d_config(config.task, config.task_parameters)
        self.step_files = StepFiles(circle2d, runs)
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
        """An epoch of these runs, where the learner holds no others."""
        run_epoch([self])

    def take_in(
        self,
        rollout: Rollout,
        learning: NDArray[np.bool_],
        metrics: NDArray,
        finite: NDArray[np.bool_],
    ) -> None:
        """Record an epoch. rollout: of R·E episodes; learning: [R], runs that learned from it;
        metrics: [R, metrics], what that came to; finite: [R], runs that the learner can go on with.
        """
        active = self.active
        self.log.add(rollout, self.steps, learning, metrics)
        self.step_files.add(rollout, learning)
        self.steps += np.where(active, rollout.length.reshape(len(active), -1).sum(axis=1), 0)
        self.failed |= active & ~(learning & finite)
        self.epoch += 1

    def save(self, folder: Path) -> None:
        """Write the records, then the checkpoint from which all of it can be written again."""
        folders = run_folders(folder, self.config)
        self.log.write(folders)
        self.step_files.write(folders)
        for of_run, failed, steps in zip(folders, self.failed, self.steps, strict=True):
            (of_run / FAILURE).unlink(missing_ok=True)
            (of_run / "evaluation.json").unlink(missing_ok=True)  # of an earlier policy
            if failed:
                write_json(of_run / FAILURE, {"step": int(steps)})
        counters = {"epoch": np.array(self.epoch), "seeds": np.array(self.config.seeds)}
        counters |= {"steps": self.steps, "failed": self.failed}
        learned = self.learner.state_dict(self.runs)
        write_arrays(folder / "checkpoint.npz", counters | self.log.state_dict() | learned)

    def load(self, folder: Path) -> None:
        """Load a checkpoint. Raises UserError where it is missing or damaged."""
        path = folder / "checkpoint.npz"
        state = read_arrays(path)
        try:
            seeds = tree.expect("seeds", state, self.steps.shape, np.int64)
            if tuple(seeds) != self.config.seeds:
                raise ValueError(f"its seeds are {seeds.tolist()}")
            self.epoch = int(tree.expect("epoch", state, (), np.int64))
            self.steps = tree.expect("steps", state, self.steps.shape, np.int64)
            self.failed = tree.expect("failed", state, self.failed.shape, np.bool_)
            self.log.load_state_dict(state, self.epoch)
            self.learner.load_state_dict(state, self.runs)
        except (KeyError, ValueError) as error:
            raise UserError(f"{path} is damaged or of another version: {error}") from None
        self.step_files.seek(run_folders(folder, self.config), self.log.steps)

    def close(self) -> None:
        """Close the environments."""
        if "_envs" in vars(self):
            self._envs.close()


def run_epoch(trainings: Sequence[Training]) -> None:
    """Collect the episodes of an epoch of every active run, and learn from them.

    trainings: all that share a learner, in the order of its runs. Those that are done stay as they
    are.
    """
    learner = trainings[0].learner
    episodes = learner.episodes
    active = np.concatenate([training.active for training in trainings])
    steps = np.concatenate([training.steps for training in trainings])
    seeds = [seed for training in trainings for seed in training.config.stream_seeds]
    epochs = np.repeat([t.epoch for t in trainings], [len(t.steps) for t in trainings])
    resets = environment_seeds(seeds, Purpose.ENVIRONMENT, epochs, episodes)
    envs = [training._envs for training in trainings]
    beside = envs[0] if len(envs) == 1 else SideBySide(envs)
    act = learner.explorer(epochs, steps)
    rollout = collect(beside, resets, act, np.repeat(active, episodes))
    learning = active & ~rollout.diverged.reshape(-1, episodes).any(axis=1)
    metrics = np.full((len(seeds), len(learner.metrics)), np.nan)
    if learning.any():
        metrics = learner.learn(rollout, epochs, learning)
    finite = learner.finite()
    for training in trainings:
        if not training.done:
            runs = training.runs
            own = rollout.of(slice(runs.start * episodes, runs.stop * episodes))
            training.take_in(own, learning[runs], metrics[runs], finite[runs])


def together(configs: Sequence[TrainConfig]) -> list[Training]:
    """Trainings of several folders with one learner, equal in what `TrainConfig.shared` holds."""
    learner = _learner_of(configs)
    first_runs = np.cumsum([0] + [len(config.seeds) for config in configs]).tolist()
    return [Training(c, learner, first) for c, first in zip(configs, first_runs, strict=False)]


def _learner_of(configs: Sequence[TrainConfig]) -> Learner:
    """A learner for the runs of some folders, one folder after the other."""
    one = configs[0]
    seeds = [seed for config in configs for seed in config.stream_seeds]
    sizes = sizes_of(one.task, one.task_parameters)
    return make_learner(one.algorithm, one.hyperparameters, seeds, *sizes)


def load_training(folder: Path) -> Training:
    """The training of a folder as its last checkpoint left it."""
    training = Training(TrainConfig.read(folder))
    training.load(folder)
    return training


OnEpoch = Callable[[Sequence[Training]], None]


def train(*folders: Path, on_epoch: OnEpoch = lambda trainings: None) -> list[Training]:
    """Train the runs of some folders to their end, from their last checkpoints if there are any.

    The folders are ones that `TrainConfig.write` made. Several train together: they differ in tasks
    and seeds only, and each is left as if it had trained alone. Settles torch's threads and
    products for the process (`backend.configure`); the last bits of results depend on them. Ends
    with an evaluation over 100 episodes. `on_epoch` is called after every epoch, to show progress.
    Raises UserError where folders cannot train together, or are being trained in.
    """
    configs = {folder: TrainConfig.read(folder) for folder in folders}
    if len(configs) > 1:
        check_together(configs)
    one = next(iter(configs.values()))
    backend.configure(one.backend == "compiled", one.device)
    with contextlib.ExitStack() as stack:
        for folder in configs:
            stack.enter_context(locked(folder))
        trainings = together(list(configs.values()))
        _train(dict(zip(configs, trainings, strict=True)), on_epoch)
    return trainings


def _train(trainings: dict[Path, Training], on_epoch: OnEpoch) -> None:
    for folder, training in trainings.items():
        if (folder / "checkpoint.npz").exists():
            training.load(folder)
        if not training.done:
            note_session(folder)
    together = list(trainings.values())
    unfinished = [folder for folder, training in trainings.items() if not training.done]
    status = StatusFiles(unfinished, together[0].config.steps)
    with contextlib.ExitStack() as stack:
        events = {}
        for folder, training in trainings.items():
            stack.callback(training.close)
            if training.config.tensorboard:
                of_folder = Events(run_folders(folder, training.config), training.steps)
                events[folder] = stack.enter_context(contextlib.closing(of_folder))
        while going := {folder: t for folder, t in trainings.items() if not t.done}:
            before = {folder: t.steps // t.config.checkpoint_every for folder, t in going.items()}
            run_epoch(together)
            for folder, training in going.items():
                if events:
                    events[folder].write(training.log, training.steps)
                passed = training.steps // training.config.checkpoint_every > before[folder]
                if training.done or passed.any():
                    training.save(folder)
            status.update(together, last=all(training.done for training in together))
            on_epoch(together)
    for folder, training in trainings.items():
        policy = training.learner.policy(training.runs)
        evaluate(folder, training.config, policy, EVALUATION_EPISODES, ~training.failed)
