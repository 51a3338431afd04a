"""CostRecorder, which turns steps into trajectories for `RecordCosts`; costs in a step's info.

If `StreakCost` has weighted info["cost"], the recorded cost is info["plain_cost"].
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from emcc.arrays import as_array, as_count, as_number, as_one, check_range, exceed
from emcc.records import COLUMNS, EpisodeRecords


class CostRecorder:
    """Records the trajectories of num_envs environments that are stepped together.

    rollout: what counts as a rollout, the steps between two policy updates that MCC is taken over:
      "episode"  every finished episode is a rollout
      n          a rollout ends with the vector step that makes it n or more environment steps long
      "manual"   a rollout ends when `end_rollout` is called
    threshold: a step whose cost exceeds it is a cost step.
    Environment steps are summed over all environments. The end of a rollout cuts the running
    episodes; each piece is a trajectory of its own.
    """

    def __init__(
        self, num_envs: int, rollout: int | str = "episode", threshold: float = 0.0
    ) -> None:
        self.num_envs = as_count(num_envs, "num_envs")
        self.threshold = as_number(threshold, "threshold", low=0)
        self.steps = 0  # environment steps so far
        self._per_episode = rollout == "episode"
        named = rollout in ("episode", "manual")
        if isinstance(rollout, str) and not named:
            raise ValueError(f"rollout must be 'episode', 'manual' or steps, got {rollout!r}")
        self._rollout_length = math.inf if named else as_count(rollout, "rollout")  # pyright: ignore[reportArgumentType]
        self._rollout = 0  # id of the current rollout
        self._rollout_start = 0
        # The running trajectory of each environment; length 0 means that none is running.
        self._start_step, self._length, self._longest, self._cost_steps, self._streaks = (
            np.zeros(num_envs, dtype=np.int64) for _ in range(5)
        )
        self._streak = np.zeros(num_envs, dtype=np.int64)  # steps of the running streak
        self._reward, self._cost = np.zeros(num_envs), np.zeros(num_envs)
        self._rows: list[tuple[Any, ...]] = []  # finished trajectories, as in EpisodeRecords

    def step(
        self, cost: ArrayLike, reward: ArrayLike, done: ArrayLike, active: ArrayLike | None = None
    ) -> None:
        """Record one step of every environment; all arguments are [num_envs].

        done: the episode ended with this step. active: False for environments that took no step
        (an autoreset, say); their cost and reward are ignored.
        ValueError: a wrong shape, a NaN, infinite or negative cost, a NaN or infinite reward.
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
        """Finish the running trajectories of all environments, or of those in the mask [num_envs].

        For episodes that end without `done`, as with an explicit reset. Steps so far are kept.
        """
        running = self._length > 0
        if where is not None:
            running &= self._mask(where)
        rows = self._running_rows(running)
        self._rows += rows
        self._rollout += len(rows) * self._per_episode
        for column in (*self._columns[1:], self._streak):
            column[running] = 0

    def end_rollout(self) -> None:
        """Cut the running episodes and begin the next rollout; does nothing without new steps.

        Called at the end of training, it keeps the running episodes, for any `rollout`.
        """
        self.cut()
        if self._rows and self._rows[-1][0] == self._rollout:
            self._rollout += 1
        self._rollout_start = self.steps

    @property
    def records(self) -> EpisodeRecords:
        """Finished trajectories, in the order in which they ended."""
        return _records(self._rows)

    @property
    def snapshot(self) -> EpisodeRecords:
        """`records` followed by the running trajectories up to now. Cuts nothing."""
        return _records(self._rows + self._running_rows(self._length > 0))

    def recent(self, rollouts: int) -> EpisodeRecords:
        """Return the finished trajectories of the last `rollouts` non-empty rollouts."""
        first, kept = len(self._rows), set()
        while first:
            kept.add(self._rows[first - 1][0])
            if len(kept) > rollouts:
                break
            first -= 1
        return _records(self._rows[first:])

    @property
    def _columns(self) -> tuple[NDArray[Any], ...]:
        """Columns of the running trajectories as in EpisodeRecords, without `rollout`."""
        sums = self._length, self._reward, self._cost
        return (self._start_step, *sums, self._longest, self._cost_steps, self._streaks)

    def _running_rows(self, running: NDArray[np.bool_]) -> list[tuple[Any, ...]]:
        """Return rows of the running trajectories in the mask [num_envs]."""
        columns = (column[running].tolist() for column in self._columns)
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
        array = self._vector(values, "done, active and where")
        if not ((array == 0) | (array == 1)).all():
            raise ValueError(f"done, active and where must be True or False, got {array}")
        return array.astype(bool)


def _records(rows: list[tuple[Any, ...]]) -> EpisodeRecords:
    return EpisodeRecords(*np.array(rows).reshape(-1, len(COLUMNS)).T)


def cost_of(info: Mapping[str, Any], name: str = "cost") -> float:
    """Return the cost of one environment's step, from the step's info.

    `CostRecorder` checks the value. KeyError: no cost. TypeError: not one number.
    """
    name = _plain(info, name)
    return as_one(info[name], f"info['{name}']")


def costs_of(
    infos: Mapping[str, Any], active: NDArray[np.bool_], done: NDArray[np.bool_], name: str = "cost"
) -> NDArray[np.float64]:
    """Return the costs of a vector environment's step, [num_envs]; 0 where `active` is False.

    active: [num_envs] environments that took a step; done: [num_envs] environments whose episode
    ended with the step. If environments reset in the step that ends an episode, infos[name] may
    belong to the next episode's reset; the last step's cost is then in infos["final_info"].
    KeyError: no cost at all. ValueError: no cost of one environment. TypeError: an array of whole
    numbers or bools, which Gymnasium has built from all costs.
    """
    final, costs = infos.get("final_info", {}), np.zeros(len(active))
    if isinstance(final, np.ndarray):  # gymnasium before 1.0: an array of dicts
        finals = active & done & np.array([info is not None for info in final])
        costs[finals] = [cost_of(info, name) for info in final[finals]]
    else:
        finals = active & done & (name in final)
        if finals.any():
            costs[finals] = _given_costs(final, finals, name)[finals]
    others = active & ~finals
    if others.any():
        costs[others] = _given_costs(infos, others, name)[others]
    return costs


def _given_costs(infos: Mapping[str, Any], needed: NDArray[np.bool_], name: str) -> NDArray[Any]:
    """Return infos[name] as an array [num_envs]. The mask infos["_" + name], which Gymnasium's
    vector environments add, must cover `needed`; with it, integers and bools are an error."""
    name = _plain(infos, name)
    missing = needed & ~np.asarray(infos.get(f"_{name}", needed), dtype=bool)
    if missing.any():
        raise ValueError(f"sub-environment {int(np.argmax(missing))} gave no {name!r} in its info")
    given, named = infos[name], f"info['{name}']"
    if isinstance(given, np.ndarray) and given.dtype == object and given.shape == needed.shape:
        each = zip(given, needed, strict=True)  # Gymnasium has no numeric array for their type
        given = np.array([as_one(cost, named) if needs else 0.0 for cost, needs in each])
    costs = as_array(given, named)
    if f"_{name}" in infos and costs.dtype.kind in "biu":
        raise TypeError(
            f"info['{name}'] came as {costs.dtype}: gymnasium's vector environments give all costs "
            "the type of the first, which may have rounded others; return every cost as a float"
        )
    if costs.size != needed.size:
        raise TypeError(
            f"info['{name}'] must be one number for each environment, got {costs.shape}"
        )
    return costs.reshape(needed.shape)


def _plain(info: Mapping[str, Any], name: str) -> str:
    """Return the key of the cost as it was before `StreakCost`. KeyError: no cost."""
    if name not in info:
        raise KeyError(f"the environment's info has no {name!r}; it has {sorted(info)}")
    return "plain_cost" if name == "cost" and "plain_cost" in info else name
