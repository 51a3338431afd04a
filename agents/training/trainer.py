"""The training of a folder's runs. It can be killed at any moment, and resumes from its newest
checkpoint."""

from __future__ import annotations

import contextlib
import functools
import time
import warnings
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from agents.algorithms import BUILT_IN, Learner
from agents.algorithms import learner as make_learner
from agents.checks import In, check
from agents.errors import (
    OWN_ERRORS,
    OwnCodeError,
    TaskFailure,
    UserError,
    described,
    no_exit,
    one_line,
    traced,
)
from agents.lockstep import backend, tree
from agents.lockstep.noise import Purpose, environment_seeds
from agents.lockstep.rollout import Rollout, collect
from agents.training import callbacks, derive
from agents.training.config import (
    CHECKPOINTS,
    CONFIG,
    COUNTERS,
    RESULTS,
    STEPS,
    RunId,
    TrainConfig,
    read_spaces,
)
from agents.training.environments import check_task, spaces_of
from agents.training.evaluation import runs_envs
from agents.training.files import (
    Arrays,
    locked,
    numbered,
    numbered_path,
    read_json,
    remove_unfinished,
    write_arrays,
    write_json,
)
from agents.training.wrappers import SideBySide
from emcc import longest_streaks

KEPT = 2
"""Checkpoints kept in a folder: the newest, and the one before in case the newest is damaged."""
WRITING_SHARE = 0.02
"""Share of the time that writing checkpoints may take."""
Callback = Callable[["Trainer"], object]
"""Called after every epoch; False (also `np.False_`) stops the training after a checkpoint."""


@no_exit()
def train(folder: Path, *own: Callback, config: TrainConfig | None = None) -> Trainer:
    """Train the runs of a folder to their end, from the newest checkpoint if there is one.

    folder: made by `TrainConfig.write`. own: further callbacks. config: that of the folder, if the
    caller has it. Changes PyTorch's threads and the kernel of networks for the process
    (`backend.configure`). NumPy has one thread meanwhile: its idle threads spin, which made two
    trainings side by side on two cores nine times slower. Ends with an evaluation and
    `results.npz`, unless they exist or a callback stopped the training. Raises UserError if another
    process trains there, and as `check_unchanged`.
    """
    config = config or TrainConfig.read(folder)
    backend.configure(config.backend)
    with threadpool_limits(1, user_api="blas"), locked(folder):
        remove_unfinished(folder)
        trainer = Trainer(folder, config)
        trainer.load()
        evaluated = trainer.done and _is_whole(folder / RESULTS)
        if trainer.steps.any() and not evaluated:
            check_unchanged(folder, config)
        with contextlib.closing(trainer), callbacks.usual(trainer) as usual:
            trainer.run((*usual, *own))
            if trainer.done and not evaluated:
                why = (trainer.failures, trainer.tracebacks)
                derive.write_results(folder, config, trainer.learner.policy(), *why)
    return trainer


def check_unchanged(folder: Path, config: TrainConfig) -> None:
    """Raise UserError if a task of a folder's runs fails in its first step, or has other spaces
    than when the runs began: they would fail for good, or go on with actions of another scale."""
    for task in config.tasks:
        check_task(task, config.task_parameters, config.task_costs)
    before, now = read_spaces(folder), spaces_of(config.tasks, config.task_parameters, config.wrap)
    if now != before:
        raise UserError(
            f"{' '.join(config.tasks)} has changed since the runs of {folder} began: it had "
            f"{before}, and has {now}; go on with the task as it was, or train in another folder"
        )


def check_longer(folder: Path, steps: int) -> None:
    """Raise UserError if the runs of a folder cannot be trained up to so many steps."""
    check("steps", steps, Annotated[int, In(1)])
    config = TrainConfig.read(folder)
    if steps < config.steps:
        raise UserError(f"steps must be at least the {config.steps} that {folder} has, got {steps}")
    if steps > config.steps:
        check_unchanged(folder, config)


def lengthen(folder: Path, steps: int) -> None:
    """Make a folder's training longer; it then continues as if it had been so from the start.

    Runs that were done and waited for others catch up first. No setting depends on the number of
    steps. Raises as `check_longer`.
    """
    check_longer(folder, steps)
    with locked(folder):
        if steps == TrainConfig.read(folder).steps:
            return
        # In this order, a kill leaves either the old training, to be resumed, or the new one.
        (folder / RESULTS).unlink(missing_ok=True)
        write_json(folder / CONFIG, read_json(folder / CONFIG) | {"steps": steps})


def _is_whole(path: Path) -> bool:
    """Whether all arrays of a file can be read."""
    try:
        return bool(dict(Arrays(path)))
    except UserError:
        return False


def _texts(arrays: Mapping[str, NDArray], name: str, shape: tuple[int, ...]) -> NDArray[np.object_]:
    """Return strings of any length. Raises KeyError if missing, ValueError if they do not fit."""
    found = arrays[name]
    if found.shape != shape or found.dtype.kind != "U":
        given = f"{list(found.shape)} {found.dtype}"
        raise ValueError(f"{name} is {given}, expected {list(shape)} strings")
    return found.astype(object)


class Trainer:
    """The runs of a folder between two epochs, and their files."""

    def __init__(self, folder: Path, config: TrainConfig) -> None:
        self.folder, self.config = folder, config
        self._sizes = read_spaces(folder).sizes
        count = len(config.runs)
        self.epochs = np.zeros(count, dtype=np.int64)
        """Epochs that each run has begun, [R]. A run that is done waits for the others; if the
        training is made longer, it catches up."""
        self.steps = np.zeros(count, dtype=np.int64)
        """Environment steps that each run has taken, [R]."""
        self.learner: Learner = self._learner(config.stream_seeds)
        if taken := sorted(set(COUNTERS) & self.learner.state_dict().keys()):
            raise UserError(
                f"the state_dict of algorithm {config.algorithm!r} has {', '.join(taken)}, which "
                "checkpoints need for the training itself: choose another name"
            )
        self.recorder = Recorder(
            config.runs, self.learner.episodes, self.learner.metrics, config.costs
        )
        self.failures = np.full(count, "", dtype=object)
        """Why each run has failed, by an error of its task, a NaN or an infinite number, [R]; ""
        for all others, which go on."""
        self.tracebacks = np.full(count, "", dtype=object)
        """Tracebacks of the tasks' errors, [R]."""
        self.cause: BaseException | None = None
        """The first error of a task that this process met."""
        self.stopped = False
        """Whether a callback stopped the training."""
        self._saved_at, self._writing = time.monotonic(), 0.0
        own = config.algorithm not in BUILT_IN and count > 1
        self._alone = self._learner(config.stream_seeds[:1]) if own else None
        self._compared = 0

    def _learner(self, stream_seeds: list[int]) -> Learner:
        config = self.config
        with self._own_code("is made"):
            return make_learner(config.algorithm, config.learned, stream_seeds, *self._sizes)

    @functools.cached_property
    def _envs(self) -> SideBySide:
        """Environments of all runs for an epoch's episodes; made when they are first needed."""
        return runs_envs(self.config, self.learner.episodes)

    @property
    def active(self) -> NDArray[np.bool_]:
        """Runs that still have steps to take, [R]."""
        return (self.steps < self.config.steps) & (self.failures == "")

    @property
    def done(self) -> bool:
        """Whether no run has steps to take."""
        return not self.active.any()

    def run(self, own: tuple[Callback, ...]) -> None:
        """Train until all runs are done or a callback returns False, and save the runs."""
        saved = True
        while not self.done and not self.stopped:
            before = self.steps.copy()
            self.run_epoch()
            answers = [callback(self) for callback in own]  # they write before the checkpoint
            self.stopped = any(isinstance(a, (bool, np.bool_)) and not a for a in answers)
            saved = self._is_due(before)
            if saved:
                self.save()
        if not saved:
            self.save()

    def _is_due(self, before: NDArray[np.int64]) -> bool:
        """Whether to save: at the end, and when a run has passed a multiple of `checkpoint_every`,
        unless writing would take more than its share of the time."""
        if self.done:
            return True
        every = self.config.checkpoint_every
        passed = (self.steps // every > before // every).any()
        since = time.monotonic() - self._saved_at
        return bool(passed and since * WRITING_SHARE >= self._writing)

    def run_epoch(self) -> None:
        """Collect an epoch's episodes and learn from them. If some runs lag in epochs, as when runs
        catch up, only those with the fewest epochs take part; otherwise all active runs."""
        config, learner, episodes = self.config, self.learner, self.learner.episodes
        active = self.active
        epoch = int(self.epochs[active].min())
        active &= self.epochs == epoch
        resets = environment_seeds(config.stream_seeds, Purpose.ENVIRONMENT, epoch, episodes)
        with self._own_code("acts"):
            act = learner.explorer(epoch, self.steps)
            playing = np.repeat(active, episodes)
            rollout = collect(self._envs, resets, act, playing, config.costs, config.most_steps)
        void = rollout.diverged.reshape(-1, episodes)
        learning = active & ~void.any(axis=1)
        metrics = np.full((len(active), len(learner.metrics)), np.nan)
        if learning.any():
            with self._own_code("learns"):
                metrics = self._learn(rollout, epoch, learning)
        self.recorder.add(rollout, self._recorded(), learning, metrics)
        self.steps += np.where(active, rollout.length.reshape(len(active), -1).sum(axis=1), 0)
        self._note_failures(rollout, active, learner.finite())
        self.epochs += active

    def _recorded(self) -> list[dict[str, NDArray[np.float32]]]:
        """Return what each run's environments recorded at each step, arrays [T, E, ...] by name."""
        recorded, seeds = [], len(self.config.seeds)
        for part in self._envs.parts:
            split = {name: np.split(c, seeds, axis=1) for name, c in part.recorded.items()}
            recorded += [{name: runs[k] for name, runs in split.items()} for k in range(seeds)]
        return recorded

    def _note_failures(
        self, rollout: Rollout, active: NDArray[np.bool_], finite: NDArray[np.bool_]
    ) -> None:
        """Stop the runs whose task failed, and those that met or hold non-finite numbers."""
        causes = rollout.failure.reshape(len(active), -1)
        for run in np.flatnonzero(active):
            own = "" if finite[run] else "update"
            if cause := next(filter(None, causes[run]), own):
                failed = isinstance(cause, TaskFailure)
                words = one_line(cause) if failed else f"its {cause} is not finite"
                self.failures[run] = f"failed at step {self.steps[run]}: {words}"
                if failed:
                    self.tracebacks[run] = traced(cause.__cause__)
                    self.cause = self.cause or cause.__cause__

    @contextlib.contextmanager
    def _own_code(self, does: str) -> Iterator[None]:
        """Name the algorithm in errors of its code, as OwnCodeError."""
        try:
            yield
        except UserError:
            raise
        except OWN_ERRORS as error:
            name, step = self.config.algorithm, int(self.steps.max())
            words = f"algorithm {name!r} failed at step {step} where it {does}: {described(error)}"
            raise OwnCodeError(words) from error

    def _learn(self, rollout: Rollout, epoch: int, learning: NDArray[np.bool_]) -> NDArray:
        """Learn from an epoch. Raises UserError if one of the first two updates of a user's own
        algorithm depends on other runs; the second is compared since all multipliers are equal in
        the first."""
        metrics = self.learner.learn(rollout, epoch, learning)
        if self._alone is None:
            return metrics
        own = self._alone.learn(rollout.of(slice(self._alone.episodes)), epoch, learning[:1])
        if not own.size or not np.isnan(own).all():  # it has learned
            together = self.learner.state_dict()
            for name, array in self._alone.state_dict().items():
                beside = together[name][:1]
                beside = beside[:, : array.shape[1]] if array.ndim > 1 else beside
                if not np.allclose(array, beside, rtol=1e-3, equal_nan=True):
                    raise UserError(
                        f"algorithm {self.config.algorithm!r} trains a run differently beside "
                        f"others than alone ({name} differs): does it reduce over the first axis, "
                        "the runs? A mean over a batch is x.mean(dim=-1), in a surrogate "
                        "agents.first_order.mean(batch, x)"
                    )
            self._compared += 1
            if self._compared == 2:
                self._alone = None
        return metrics

    def save(self) -> None:
        """Write the new steps, then a checkpoint; keep the `KEPT` newest checkpoints."""
        began = time.monotonic()
        # File number: steps of the active run with the fewest; at the end, the most of any run. It
        # must increase, but a run whose first action fails has taken no step since the last file.
        steps = self.steps.max() if self.done else self.steps[self.active].min()
        number = max(int(steps), 1 + max(numbered(self.folder, CHECKPOINTS), default=-1))
        texts = (self.failures.astype(np.str_), self.tracebacks.astype(np.str_))
        counters = (self.epochs, self.steps, *texts)
        state = dict(zip(COUNTERS, counters, strict=True)) | self.learner.state_dict()
        for name, arrays in ((STEPS, self.recorder.take()), (CHECKPOINTS, state)):
            (self.folder / name).mkdir(exist_ok=True)
            write_arrays(numbered_path(self.folder, name, number), arrays)
        for path in list(numbered(self.folder, CHECKPOINTS).values())[:-KEPT]:
            Path(str(path)).unlink(missing_ok=True)
        self._saved_at = time.monotonic()
        self._writing = self._saved_at - began

    def load(self) -> None:
        """Load the newest checkpoint that is undamaged and whose steps exist; remove later files.

        Warns of damaged checkpoints. Raises UserError if all are damaged.
        """
        checkpoints = numbered(self.folder, CHECKPOINTS)
        last: UserError | None = None
        for number in reversed(checkpoints):
            try:
                self._load(Arrays(checkpoints[number]))
                self._check_steps(number)
                break
            except UserError as error:
                last = last or error
        else:
            if last:
                raise last
            number = -1
        if last:
            warnings.warn(
                f"{last}: going on from the checkpoint before it, {int(self.steps.min())} of "
                f"{self.config.steps} steps",
                stacklevel=2,
            )
        for name in (CHECKPOINTS, STEPS):
            for later, path in numbered(self.folder, name).items():
                if later > number:
                    Path(str(path)).unlink()
        if not self.done:
            (self.folder / RESULTS).unlink(missing_ok=True)

    def _check_steps(self, number: int) -> None:
        """Raise UserError if the files of steps up to a checkpoint do not hold the runs' steps."""
        recorded = derive.steps_recorded(self.folder, self.config, number)
        going = self.failures == ""  # the epoch in which a run failed is not recorded
        if not np.array_equal(recorded[going], self.steps[going]):
            raise UserError(
                f"{self.folder / STEPS} is damaged: it holds {recorded.tolist()} steps of the "
                f"runs, the checkpoint has {self.steps.tolist()}"
            )

    def _load(self, state: Arrays) -> None:
        """Load a checkpoint. Raises UserError if it is damaged."""
        try:
            content = dict(state)
            self.learner.load_state_dict(content)
            self.steps = tree.expect("steps", content, self.steps.shape, np.int64)
            self.failures = _texts(content, "failures", self.steps.shape)
            content.setdefault("tracebacks", np.full(self.steps.shape, ""))  # before 0.4
            self.tracebacks = _texts(content, "tracebacks", self.steps.shape)
            if content["epoch"].ndim == 0:  # before 0.4 one number for all
                content["epoch"] = np.full(self.steps.shape, content["epoch"])
            self.epochs = tree.expect("epoch", content, self.steps.shape, np.int64)
            self._alone = None
        except (KeyError, ValueError) as error:
            if isinstance(error, UserError):
                raise
            raise UserError(f"{state.path} is damaged or of another version: {error}") from error

    def close(self) -> None:
        """Close the environments."""
        if "_envs" in vars(self):
            self._envs.close()


RECENT = 20
"""Number of epochs over which progress shows means."""


class Recorder:
    """Records of every run's steps, episodes and updates since the last `take`.

    Arrays of a run, whose names begin with its prefix: for every step "costs/NAME" [steps] and what
    environments record (`RecordSteps.recorded`), "positions" [steps, 2] and "info/NAME" [steps];
    "length" and "return" of every episode; "updates" [epochs, metrics], NaN where nothing was
    learned.
    """

    def __init__(
        self, runs: Sequence[RunId], episodes: int, metrics: Sequence[str], costs: Sequence[str]
    ) -> None:
        """episodes: number per run and epoch; metrics: names of the numbers of an update."""
        self.runs, self.episodes, self.metrics, self.costs = runs, episodes, metrics, costs
        self._new: dict[str, list[NDArray]] = {}
        self._recent: deque[tuple[float, float]] = deque(maxlen=RECENT)
        self.latest: dict[RunId, dict[str, float]] = {}
        """Numbers of the last epoch for each run that took part: means over its episodes of
        "return", "length" and the costs by their names; "mcc"; and the metrics that are not NaN."""

    def add(
        self,
        rollout: Rollout,
        recorded: Sequence[Mapping[str, NDArray[np.float32]]],
        active: NDArray[np.bool_],
        metrics: NDArray,
    ) -> None:
        """Add an epoch.

        rollout: R·E episodes; recorded: arrays [T, E, ...] of each run; active: [R], runs that took
        part; metrics: [R, metrics] of their updates.
        """
        shape = (len(self.runs), self.episodes)
        lengths, returns = rollout.length.reshape(shape), rollout.returns.reshape(shape)
        costs = rollout.cost.reshape(len(rollout.cost), *shape, -1)
        totals = rollout.cost_returns.reshape(*shape, -1)
        self.latest = {}
        for k in np.flatnonzero(active).tolist():
            run = self.runs[k]
            during = [slice(0, n) for n in lengths[k]]
            for c, name in enumerate(self.costs):
                rows = [costs[steps, k, e, c] for e, steps in enumerate(during)]
                self._append(run, f"costs/{name}", *rows)
            for name, values in recorded[k].items():
                self._append(run, name, *[values[steps, e] for e, steps in enumerate(during)])
            self._append(run, "length", lengths[k].astype(np.int64))
            self._append(run, "return", returns[k].astype(np.float64))
            self._append(run, "updates", metrics[k][None].astype(np.float32))
            first = np.concatenate([costs[steps, k, e, 0] for e, steps in enumerate(during)])
            streaks = longest_streaks(first, lengths[k])
            numbers = {"return": returns[k].mean(), "length": lengths[k].mean()}
            numbers |= {"mcc": (streaks / lengths[k]).max()}
            numbers |= {name: totals[k, :, c].mean() for c, name in enumerate(self.costs)}
            named = zip(self.metrics, metrics[k], strict=True)
            numbers |= {name: value for name, value in named if not np.isnan(value)}
            self.latest[run] = {name: float(value) for name, value in numbers.items()}
        if active.any():
            self._recent.append((returns[active].mean(), totals[active, :, 0].mean()))

    def _append(self, run: RunId, name: str, *rows: NDArray) -> None:
        self._new.setdefault(run.prefix + name, []).extend(rows)

    def take(self) -> dict[str, NDArray]:
        """Return the new arrays by name, and forget them."""
        arrays = {name: np.concatenate(rows) for name, rows in self._new.items()}
        self._new = {}
        return {"metrics": np.array(self.metrics, dtype=np.str_), **arrays}

    @property
    def recent(self) -> tuple[float, float]:
        """Mean return and cost of the last `RECENT` epochs' episodes; NaN before the first."""
        if not self._recent:
            return np.nan, np.nan
        returns, costs = np.mean(self._recent, axis=0)
        return float(returns), float(costs)
