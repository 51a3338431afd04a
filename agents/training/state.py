"""The state of a training between two epochs, and its files."""

from __future__ import annotations

import functools
import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from agents.algorithms import learner as make_learner
from agents.errors import UserError
from agents.lockstep import tree
from agents.lockstep.learner import Learner
from agents.lockstep.noise import Purpose, environment_seeds
from agents.lockstep.rollout import Rollout, collect
from agents.training.checksums import digest, replacing, write_whole
from agents.training.config import (
    CHECKPOINT,
    FAILURE,
    PREVIOUS,
    TrainConfig,
    read_spaces,
    run_folder,
    run_folders,
)
from agents.training.environments import make_envs, spaces_of, view_of
from agents.training.files import compare, json_bytes, npz_bytes, read_arrays
from agents.training.positions import RecordPositions
from agents.training.records import Log
from agents.training.side_by_side import SideBySide
from agents.training.step_files import VISITED, StepFiles


class Training:
    """The runs of one folder, between two epochs."""

    def __init__(
        self,
        config: TrainConfig,
        sizes: tuple[int, int] | None = None,
        learner: Learner | None = None,
        first_run: int = 0,
    ) -> None:
        """sizes: of observations and actions, by default the task is asked. learner: one that holds
        runs of other folders too, and these from `first_run` on; by default one for these alone."""
        self.config = config
        runs = len(config.seeds)
        sizes = sizes or spaces_of(config.task, config.task_parameters).sizes
        self.learner = _learner_of([config], sizes) if learner is None else learner
        self.runs = slice(first_run, first_run + runs)
        """Which runs of the learner these are."""
        self.log = Log(runs, self.learner.episodes, self.learner.metrics)
        self._view = view_of(config.task, config.task_parameters, sizes)
        self.step_files = StepFiles(self._view is not None, runs)
        self.epoch = self.epochs_here = 0
        """Epochs in all, and those of this process."""
        self.steps = np.zeros(runs, dtype=np.int64)
        """Environment steps each run has taken, [R]."""
        self.failed = np.zeros(runs, dtype=bool)
        """Runs that met a NaN or an infinite number, [R]. They stop; the others go on."""
        self._fell_back = False
        self._checkpoint_digest: str | None = None

    @functools.cached_property
    def _envs(self) -> VectorEnv:
        """The environments of an epoch; made when they are first needed."""
        config, count = self.config, len(self.config.seeds) * self.learner.episodes
        how = (config.vectorization, config.step_timeout)
        envs = make_envs(config.task, count, config.task_parameters, *how)
        return envs if self._view is None else RecordPositions(envs, self._view)

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

    def record_epoch(
        self,
        rollout: Rollout,
        learning: NDArray[np.bool_],
        metrics: NDArray,
        finite: NDArray[np.bool_],
    ) -> None:
        """Record an epoch that the environments have just gone through.

        rollout: of R·E episodes; learning: [R], runs that learned from it; metrics: [R, metrics] of
        their updates; finite: [R], runs that the learner can go on with.
        """
        active = self.active
        self.log.add(rollout, self.steps, learning, metrics)
        envs = self._envs
        positions = envs.positions if isinstance(envs, RecordPositions) else None
        self.step_files.add(rollout, learning, positions)
        self.steps += np.where(active, rollout.length.reshape(len(active), -1).sum(axis=1), 0)
        self.failed |= active & ~(learning & finite)
        self.epoch += 1
        self.epochs_here += 1

    def save(self, folder: Path) -> None:
        """Write the records, then the checkpoint; the one before stays beside it."""
        counters = {"epoch": np.array(self.epoch), "seeds": np.array(self.config.seeds)}
        counters |= {"steps": self.steps, "failed": self.failed}
        learned = self.learner.state_dict(self.runs)
        checkpoint = npz_bytes(counters | self.log.state_dict() | learned)
        sums = {CHECKPOINT: digest(checkpoint), PREVIOUS: self._checkpoint_digest}
        self._write_records(folder, sums, checkpoint)
        self._checkpoint_digest = digest(checkpoint)

    def restore_records(self, folder: Path) -> None:
        """Write the records as they were at the checkpoint that was loaded.

        A process that was killed may have written more; some may have been lost or damaged. Where
        the checkpoint before was loaded, it takes the place of the damaged one.
        """
        if not self._fell_back:
            self._write_records(folder, {})
            return
        self._write_records(folder, {CHECKPOINT: self._checkpoint_digest, PREVIOUS: None})
        os.replace(folder / PREVIOUS, folder / CHECKPOINT)
        self._fell_back = False

    def _write_records(
        self,
        folder: Path,
        sums: Mapping[str, str | None],
        checkpoint: bytes | None = None,
    ) -> None:
        """Write the files of each run that follow from the state, and their checksums.

        sums: those of checkpoints, where another one becomes the last; the evaluation of the old
        one's policy is removed. checkpoint: the content of a new one, written last.
        """
        folders, of_log = run_folders(folder, self.config), self.log.files()
        removed = {"evaluation.json": None} if sums else {}
        contents: dict[str, bytes | None] = self._named(
            lambda run: of_log[run] | removed | {FAILURE: self._failure(run)}
        )
        of_steps = self.step_files.digests()
        known = {k: None if data is None else digest(data) for k, data in contents.items()}
        with replacing(folder, known | self._named(lambda run: of_steps[run]) | dict(sums)):
            self.step_files.write(folders)
            for name, data in contents.items():
                if data is None:
                    (folder / name).unlink(missing_ok=True)
                else:
                    write_whole(folder / name, data)
            if checkpoint is not None:
                write_whole(folder / CHECKPOINT, checkpoint, keep=folder / PREVIOUS)

    def _failure(self, run: int) -> bytes | None:
        return json_bytes({"step": int(self.steps[run])}) if self.failed[run] else None

    def _named(self, of_run: Callable[[int], Mapping[str, Any]]) -> dict[str, Any]:
        """Entries of each run under their names below the folder of the runs."""
        return {
            f"{run_folder(Path(), seed).name}/{name}": value
            for run, seed in enumerate(self.config.seeds)
            for name, value in of_run(run).items()
        }

    def load(self, folder: Path) -> None:
        """Load the last checkpoint, or with a warning the one before, where that is damaged.

        Raises UserError where there is none that is whole.
        """
        try:
            self._load(folder / CHECKPOINT)
        except UserError as error:
            if not (folder / PREVIOUS).exists():
                raise
            try:
                self._load(folder / PREVIOUS)
            except UserError:
                raise error from None
            self._fell_back = True
            warnings.warn(
                f"{error}: going on from the checkpoint before it, {int(self.steps.min())} of "
                f"{self.config.steps} steps",
                stacklevel=2,
            )
        folders = run_folders(folder, self.config)
        if self._view and self.epoch and not any((of / VISITED).exists() for of in folders):
            self._view = None  # trained so far by a version without positions of this task
            self.step_files = StepFiles(False, len(folders))
        self.step_files.seek(folders, self.log.steps)

    def _load(self, path: Path) -> None:
        """Load a file. Raises UserError where it is missing or damaged."""
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
        self._checkpoint_digest = compare(path, path.read_bytes())

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
            training.record_epoch(own, learning[runs], metrics[runs], finite[runs])


def joint_trainings(configs: Mapping[Path, TrainConfig]) -> list[Training]:
    """Trainings of several folders with one learner. They differ in task and seeds alone."""
    several = list(configs.values())
    sizes = read_spaces(next(iter(configs)), several[0]).sizes
    learner = _learner_of(several, sizes)
    first_runs = np.cumsum([0] + [len(config.seeds) for config in several]).tolist()
    pairs = zip(several, first_runs, strict=False)
    return [Training(config, sizes, learner, first) for config, first in pairs]


def _learner_of(configs: Sequence[TrainConfig], sizes: tuple[int, int]) -> Learner:
    """A learner for the runs of some folders, one folder after the other."""
    one = configs[0]
    seeds = [seed for config in configs for seed in config.stream_seeds]
    return make_learner(one.algorithm, one.hyperparameters, seeds, *sizes)
