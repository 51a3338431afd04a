"""Steps in, trajectories out: the bookkeeping of `RecordCosts`, without gymnasium."""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from emcc.arrays import as_array, as_count, as_threshold, check_range, exceed
from emcc.records import COLUMNS, EpisodeRecords


class CostRecorder:
    """Follows num_envs environments that are stepped together, and keeps their trajectories.

    rollout: the steps between two policy updates, over which MCC is taken:
      "episode"  every finished episode is a rollout
      n          a rollout ends with the vector step that makes it n or more environment steps long
      "manual"   a rollout ends when `end_rollout` is called
    threshold: a step whose cost exceeds it is a cost step.
    Environment steps are counted over all environments. Where a rollout ends, running episodes are
    cut, and each piece is a trajectory of its own.
    """

    def __init__(
        self, num_envs: int, rollout: int | str = "episode", threshold: float = 0.0
    ) -> None:
        self.num_envs = as_count(num_envs, "num_envs")
        self.threshold = as_threshold(threshold)
        self.steps = 0  # environment steps so far
        self._per_episode = rollout == "episode"
        self._rollout_length = _as_rollout_length(rollout)
        self._rollout = 0  # id of the current rollout
        self._rollout_start = 0
        # The running trajectory of each environment; length 0 stands for none.
        self._start_step = np.zeros(num_envs, dtype=np.int64)
        self._length = np.zeros(num_envs, dtype=np.int64)
        self._reward = np.zeros(num_envs)
        self._cost = np.zeros(num_envs)
        self._streak = np.zeros(num_envs, dtype=np.int64)  # the one that has not ended yet
        self._longest = np.zeros(num_envs, dtype=np.int64)
        self._cost_steps = np.zeros(num_envs, dtype=np.int64)
        self._streaks = np.zeros(num_envs, dtype=np.int64)
        self._rows: list[tuple[Any, ...]] = []  # finished trajectories, as in EpisodeRecords

    def step(
        self, cost: ArrayLike, reward: ArrayLike, done: ArrayLike, active: ArrayLike | None = None
    ) -> None:
        """Record one step of every environment; all arguments are [num_envs].

        done: the episode ended with this step. active: False where the environment took no step
        (an autoreset, say); its other values are then ignored.
        ValueError: another shape, a NaN, infinite or negative cost, a NaN or infinite reward.
        """
        active = np.ones(self.num_envs, dtype=bool) if active is None else self._mask(active)
        cost = np.where(active, self._vector(cost, "cost"), 0.0)
        reward = np.where(active, self._vector(reward, "reward"), 0.0)
        done = self._mask(done) & active
        check_range(cost, "cost of the environments", low=0)
        check_range(reward, "reward of the environments")

        self._start_step[self._length == 0] = self.steps
        self._length += active
        self._reward += reward
        self._cost += cost
        unsafe = exceed(cost, self.threshold)
        self._streak[active & ~unsafe] = 0
        self._streaks += unsafe & (self._streak == 0)
        self._cost_steps += unsafe
        self._streak += unsafe
        np.maximum(self._longest, self._streak, out=self._longest)
        self.steps += int(np.count_nonzero(active))

        if done.any():
            self.cut(done)
        if self.steps - self._rollout_start >= self._rollout_length:
            self.end_rollout()

    def cut(self, where: ArrayLike | None = None) -> None:
        """Finish the running trajectories, of all environments or where the mask [num_envs] says.

        For episodes that end unseen, as with an explicit reset. The steps so far are kept.
        """
        running = self._length > 0
        if where is not None:
            running &= self._mask(where)
        rows = self._rows_of(running)
        self._rows += rows
        self._rollout += len(rows) * self._per_episode
        for column in (*self._sums, self._streak):
            column[running] = 0

    def end_rollout(self) -> None:
        """Cut the running episodes and begin the next rollout; nothing happens without new steps.

        At the end of training this keeps the episodes that are still running, in any mode.
        """
        self.cut()
        if self._rows and self._rows[-1][0] == self._rollout:
            self._rollout += 1
        self._rollout_start = self.steps

    @property
    def records(self) -> EpisodeRecords:
        """The trajectories finished so far, in the order in which they ended."""
        return _records(self._rows)

    @property
    def snapshot(self) -> EpisodeRecords:
        """`records`, and behind them the running trajectories as far as they are. Cuts nothing."""
        return _records(self._rows + self._rows_of(self._length > 0))

    def recent(self, rollouts: int) -> EpisodeRecords:
        """The finished trajectories of the last so many rollouts that have any."""
        first, kept = len(self._rows), set()
        while first:
            kept.add(self._rows[first - 1][0])
            if len(kept) > rollouts:
                break
            first -= 1
        return _records(self._rows[first:])

    @property
    def _sums(self) -> tuple[NDArray[Any], ...]:
        """The columns of the running trajectories that begin at 0."""
        sums = (self._length, self._reward, self._cost, self._longest)
        return (*sums, self._cost_steps, self._streaks)

    def _rows_of(self, running: NDArray[np.bool_]) -> list[tuple[Any, ...]]:
        """Rows of the running trajectories where the mask [num_envs] says."""
        columns = (column[running].tolist() for column in (self._start_step, *self._sums))
        return [
            (self._rollout + place * self._per_episode, *row)
            for place, row in enumerate(zip(*columns, strict=True))
        ]

    def _vector(self, values: ArrayLike, name: str) -> NDArray[Any]:
        array = as_array(values, name)
        if array.shape != (self.num_envs,):
            raise ValueError(f"{name} must have shape ({self.num_envs},), got {array.shape}")
        return array

    def _mask(self, values: ArrayLike) -> NDArray[np.bool_]:
        return self._vector(values, "done, active and where").astype(bool)


def _records(rows: list[tuple[Any, ...]]) -> EpisodeRecords:
    return EpisodeRecords(*np.array(rows).reshape(-1, len(COLUMNS)).T)


def _as_rollout_length(rollout: int | str) -> float:
    """Environment steps of a rollout; infinite where something else ends it."""
    if isinstance(rollout, str):
        if rollout not in ("episode", "manual"):
            raise ValueError(f'rollout must be "episode", "manual" or a number, got {rollout!r}')
        return math.inf
    return as_count(rollout, "rollout")
