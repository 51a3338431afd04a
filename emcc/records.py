"""Records of a training run: one row per trajectory, and their CSV file."""

import math
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from emcc.arrays import as_array, as_count, as_integers, as_steps, check_range, named
from emcc.parts import ALPHA, emcc, emcc_by_part, rollouts_by_part
from emcc.streaks import count_streaks, longest_streaks

COLUMNS = {  # of the CSV file, in the order of the fields of EpisodeRecords
    "rollout": int,
    "start_step": int,
    "length": int,
    "return": float,
    "cost": float,
    "longest_streak": int,
    "cost_steps": int,
    "streaks": int,
}


@dataclass(frozen=True, eq=False, repr=False)
class EpisodeRecords:
    """The trajectories of a training run: parallel arrays [E], one row per trajectory, read-only.

    A trajectory is an episode, or a piece of an episode that the end of a rollout cut.

    rollout: id of the rollout that the trajectory belongs to, >= 0
    start_step: environment steps of the whole run that were taken before the trajectory started
    length: steps, >= 1
    reward: undiscounted return (column `return` of the file)
    cost: sum of costs, >= 0
    longest_streak: steps in the longest streak of cost steps, between 0 and length
    cost_steps: number of cost steps, between longest_streak and length; None if not recorded
    streaks: number of streaks; cost_steps / streaks is their mean length; None if not recorded
    ValueError: arrays that are not 1-D and of one length, or a value that is not allowed.
    """

    rollout: NDArray[np.int64]
    start_step: NDArray[np.int64]
    length: NDArray[np.int64]
    reward: NDArray[np.float64]
    cost: NDArray[np.float64]
    longest_streak: NDArray[np.int64]
    cost_steps: NDArray[np.int64] | None = None
    streaks: NDArray[np.int64] | None = None

    def __post_init__(self) -> None:
        if (self.cost_steps is None) != (self.streaks is None):
            raise ValueError("cost_steps and streaks must be given together, or neither")
        for name, values in self._columns().items():
            low = {"length": 1, "return": -math.inf}.get(name, 0)
            if COLUMNS[name] is int:
                array = as_integers(values, name, low)
            else:
                array = as_array(values, name).astype(np.float64)
                check_range(array, name, low)
            array.flags.writeable = False
            object.__setattr__(self, "reward" if name == "return" else name, array)
        shapes = sorted({array.shape for array in self._columns().values()})
        if len(shapes) > 1 or len(shapes[0]) != 1:
            raise ValueError(f"the arrays must be 1-D and of one length, got shapes {shapes}")
        longest, possible = self.longest_streak, self.longest_streak <= self.length
        if self.cost_steps is not None and self.streaks is not None:
            steps, streaks = self.cost_steps, self.streaks
            # At least one safe step separates two streaks, and none is longer than the longest.
            possible &= -(-steps // np.maximum(longest, 1)) <= streaks
            possible &= longest + streaks - 1 <= steps
            possible &= steps + streaks - 1 <= self.length
            possible &= (longest > 0) & (longest <= steps)
            possible |= (steps == 0) & (longest == 0) & (streaks == 0)
        if not possible.all():
            row = int(np.argmin(possible))
            named = (f"{name} {array[row]}" for name, array in list(self._columns().items())[5:])
            problem = f"{self.length[row]} steps cannot have {', '.join(named)}"
            raise ValueError(f"{problem}, at index {row}")

    def _columns(self) -> dict[str, NDArray]:
        """Return the recorded columns by their names in the file."""
        named = zip(COLUMNS, vars(self).values(), strict=True)
        return {name: array for name, array in named if array is not None}

    def __reduce__(self) -> tuple[Any, ...]:
        return EpisodeRecords, tuple(vars(self).values())  # NumPy's own pickles can be written to

    def __len__(self) -> int:
        return len(self.rollout)

    def __repr__(self) -> str:
        rollouts = len(np.unique(self.rollout))
        sizes = f"{len(self)} trajectories, {rollouts} rollouts, {self.total_steps} steps"
        return f"EpisodeRecords({sizes})"

    @property
    def total_steps(self) -> int:
        """Environment steps summed over all trajectories."""
        return int(self.length.sum())

    @property
    def mean_streak(self) -> float | None:
        """All cost steps / all streaks, in steps; 0 without a streak, None if not recorded."""
        if self.cost_steps is None or self.streaks is None:
            return None
        return float(self.cost_steps.sum() / max(int(self.streaks.sum()), 1))

    def mcc_per_rollout(self) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Return MCC in [0, 1] and start step of each rollout, sorted by id: two arrays [D].

        A rollout starts with the first of its trajectories. Source: equation (mcc).
        """
        rollouts, row_of = np.unique(self.rollout, return_inverse=True)
        mcc_values = np.zeros(len(rollouts))
        np.maximum.at(mcc_values, row_of, self.longest_streak / self.length)
        start_steps = np.full(len(rollouts), np.iinfo(np.int64).max)
        np.minimum.at(start_steps, row_of, self.start_step)
        return mcc_values, start_steps

    def windows(
        self, window: int | None = None, window_steps: int | None = None
    ) -> "EpisodeRecords":
        """Return the same trajectories, with windows of equal size in place of the rollouts.

        MCC is a maximum over a rollout and grows with the rollout's size: trainings whose rollouts
        differ in size, such as one episode or ten, can only be compared over equal windows.
        window: consecutive trajectories per window, by start step. window_steps: environment steps
        per window, counted from the first step of training; a window has all trajectories that
        start within its steps, for trajectories of different lengths. An incomplete last window is
        dropped, which may leave nothing; with neither argument, the rollouts stay.
        ValueError: both arguments, or a number below 1.
        """
        if window is not None and window_steps is not None:
            raise ValueError("give window, in episodes, or window_steps, but not both")
        if window is not None:
            ids = np.arange(len(self)) // as_count(window, "window")
            whole = ids < len(self) // window
        elif window_steps is not None:
            ids = np.sort(self.start_step) // as_count(window_steps, "window_steps")
            whole = ids < self.total_steps // window_steps
        else:
            return self
        rows = np.argsort(self.start_step, kind="stable")
        return replace(self.select(rows[whole]), rollout=ids[whole])

    def emcc(
        self,
        alpha: float = ALPHA,
        ties: str = "split",
        window: int | None = None,
        window_steps: int | None = None,
    ) -> float:
        """Return EMCC of all rollouts: `emcc.emcc`, but alpha defaults to 0.1 here and 1 there.

        window, window_steps: replace the rollouts by windows, as in `windows`.
        ValueError: no trajectory, no window, or alpha or ties as in `emcc.emcc`.
        """
        return emcc(self._mcc(window, window_steps)[0], alpha, ties)

    def emcc_by_part(
        self,
        alpha: float = ALPHA,
        ties: str = "split",
        total_steps: int | None = None,
        window: int | None = None,
        window_steps: int | None = None,
    ) -> dict[float, float]:
        """Return EMCC of each third, {0.33: ..., 0.66: ..., 0.99: ...}: `emcc.emcc_by_part`.

        total_steps: environment steps of the whole training, by default the recorded ones.
        window, window_steps: replace the rollouts by windows, as in `windows`; a window belongs to
        the part in which its first trajectory starts.
        ValueError: as in `emcc.emcc_by_part`; no window; fewer total_steps than are recorded; no
        total_steps although trajectories are missing, so that one starts after the recorded steps.
        """
        mcc_values, start_steps = self._mcc(window, window_steps)
        return emcc_by_part(mcc_values, start_steps, self._total(total_steps), alpha, ties)

    def _mcc(
        self, window: int | None, window_steps: int | None
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """`mcc_per_rollout` of the rollouts or windows. ValueError: no trajectory, no window."""
        check_records(self)
        found = self.windows(window, window_steps)
        if not len(found):
            size = f"{window} episodes" if window is not None else f"{window_steps} steps"
            there = f"{len(self)} trajectories of {self.total_steps} steps"
            raise ValueError(f"no window of {size} in {there}: take a smaller window")
        return found.mcc_per_rollout()

    def by_part(self, total_steps: int | None = None) -> dict[float, "EpisodeRecords"]:
        """Return the trajectories by third of training; each rollout belongs to the third in which
        it starts. total_steps: as in `emcc_by_part`."""
        _, row_of = np.unique(self.rollout, return_inverse=True)
        parts = rollouts_by_part(self.mcc_per_rollout()[1], self._total(total_steps))
        return {part: self.select(where[row_of]) for part, where in parts.items()}

    def _total(self, total_steps: int | None) -> int:
        if total_steps is None and len(self) and self.start_step.max() >= self.total_steps:
            raise ValueError(
                f"a trajectory starts at step {self.start_step.max()}, but only {self.total_steps} "
                "steps are recorded: give total_steps, or end the last rollout first"
            )
        if total_steps is None:
            return self.total_steps
        if as_count(total_steps, "total_steps") < self.total_steps:
            raise ValueError(
                f"total_steps must be at least the {self.total_steps} steps that are recorded, got "
                f"{total_steps}: leave it out if the training is over"
            )
        return total_steps

    def select(self, rows: NDArray) -> "EpisodeRecords":
        """Return the records of some trajectories; rows: a mask [E], or indices."""
        return EpisodeRecords(*(array[rows] for array in self._columns().values()))

    @classmethod
    def from_costs(
        cls,
        costs: ArrayLike,
        lengths: ArrayLike | None = None,
        rewards: ArrayLike | None = None,
        rollouts: ArrayLike | None = None,
        threshold: float = 0.0,
    ) -> "EpisodeRecords":
        """Return records computed from the cost of every step.

        costs: the trajectories in the order of training, an array [T] each, or all of them one
        after another in an array [sum of lengths]. lengths: [E] steps, needed with a single array.
        rewards: in the same form as costs; without rewards, returns are 0. rollouts: [E] id of each
        trajectory's rollout; by default each trajectory is a rollout. threshold: as in
        `longest_streak`.
        ValueError: as in `longest_streaks`, or arrays whose lengths do not match.
        """
        costs, lengths = as_steps(costs, lengths, "costs", low=0)
        longest = longest_streaks(costs, lengths, threshold)
        cost_steps, streaks = count_streaks(costs, lengths, threshold)
        lengths = as_integers(lengths, "lengths")
        starts = np.cumsum(lengths) - lengths
        rewards = np.zeros(costs.size) if rewards is None else rewards
        gains, _ = as_steps(rewards, lengths, "rewards")
        if gains.shape != costs.shape:
            raise ValueError(f"{costs.size} costs, but rewards have shape {gains.shape}")
        reward, cost = (np.add.reduceat(x.astype(np.float64), starts) for x in (gains, costs))
        ids = np.arange(len(lengths)) if rollouts is None else as_array(rollouts, "rollouts")
        return cls(ids, starts, lengths, reward, cost, longest, cost_steps, streaks)

    @classmethod
    def merge(
        cls,
        records: Iterable["EpisodeRecords"],
        interleaved: bool = True,
        shared_rollouts: bool = False,
    ) -> "EpisodeRecords":
        """Merge the records that several recorders made of one training.

        interleaved: True for N environments that were stepped together, each with its own recorder
        (Stable-Baselines3's wrapper_class): step s of a recorder is step N s of the training, and
        rows are sorted by the end of the trajectories. This needs every environment to take each
        step, unlike Gymnasium's NEXT_STEP mode, where a reset takes a step. False for sessions one
        after another.
        shared_rollouts: rollouts with the same id are one rollout; by default they stay separate.
        TypeError: not EpisodeRecords. ValueError: no records, or shared_rollouts for sessions.
        """
        parts = list(records)
        for part in parts:
            check_records(part, fewest=0)
        if not parts:
            raise ValueError("there are no records to merge")
        if shared_rollouts and not interleaved:
            raise ValueError("shared_rollouts needs interleaved records")
        count, sizes = len(parts), [len(part) for part in parts]
        tables = [part._columns() for part in parts]
        shared = min(tables, key=len)  # columns that every part has
        columns = {name: np.concatenate([table[name] for table in tables]) for name in shared}
        if interleaved:
            end = columns["start_step"] + columns["length"]
            columns["start_step"] = columns["start_step"] * count
            if not shared_rollouts:
                recorder = np.repeat(np.arange(count), sizes)
                columns["rollout"] = columns["rollout"] * count + recorder
            order = np.argsort(end, kind="stable")  # by end, equal ends by environment
            return cls(*(column[order] for column in columns.values()))
        steps = np.cumsum([0, *(part.total_steps for part in parts)])[:-1]
        rollouts = np.cumsum([0, *(int(part.rollout.max(initial=-1)) + 1 for part in parts)])[:-1]
        columns["start_step"] = columns["start_step"] + np.repeat(steps, sizes)
        columns["rollout"] = columns["rollout"] + np.repeat(rollouts, sizes)
        return cls(*columns.values())

    def to_csv(self) -> str:
        """Return the text of the CSV file; equal records give equal text."""
        columns = self._columns()
        rows = zip(*(array.tolist() for array in columns.values()), strict=True)
        return "\n".join([",".join(columns), *(",".join(map(repr, row)) for row in rows), ""])

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a CSV file atomically; equal records give equal bytes. ValueError: the path is a
        device or a pipe, which the file would replace."""
        path = Path(path)
        if path.exists() and not (path.is_file() or path.is_dir()):
            raise ValueError(f"{path} is a device or a pipe, which must not be replaced by a file")
        unfinished = path.with_name(f".{path.name}.{os.getpid()}.unfinished")
        try:
            with unfinished.open("w", encoding="utf-8", newline="") as file:
                file.write(self.to_csv())
                file.flush()
                os.fsync(file.fileno())
            os.replace(unfinished, path)
        finally:
            unfinished.unlink(missing_ok=True)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "EpisodeRecords":
        """Read a file that `save` has written; the numbers are restored exactly.

        The file may also have just the columns cost, length and longest_streak, a row per episode
        in the order of training: then each episode is a rollout, and returns are 0 unless there is
        a column `return`. ValueError: a damaged file, or other columns.
        """
        from emcc.table import Columns  # needed only for files

        with named(path):
            return cls._from_columns(Columns(Path(path)))

    @classmethod
    def _from_columns(cls, columns: Any) -> "EpisodeRecords":
        """Return the records in the `emcc.table.Columns` of a file; see `load`."""
        ids = {"rollout", "start_step"}
        needed = {"length", "cost", "longest_streak"} | (ids if ids & columns.keys() else set())
        if missing := needed - columns.keys():
            raise ValueError(f"the columns {', '.join(sorted(missing))} are missing")
        if not columns.complete:  # a number may have lost its last digits
            raise ValueError("the last line is cut off")
        arrays = {k: columns.numbers(k, kind) for k, kind in COLUMNS.items() if k in columns}
        length = arrays["length"]
        arrays.setdefault("rollout", np.arange(len(length)))
        arrays.setdefault("start_step", np.cumsum(length) - length)
        arrays.setdefault("return", np.zeros(len(length)))
        return cls(*map(arrays.get, COLUMNS))  # pyright: ignore[reportArgumentType]


def unpack_costs(arrays: Mapping[str, NDArray], prefix: str) -> NDArray[np.float64]:
    """Return the costs of steps from three arrays whose names begin with prefix: "steps", their
    number; "unsafe", a bit per step, set if it costs; "values", the nonzero costs unless all 1."""
    steps, bits = int(arrays[prefix + "steps"]), arrays[prefix + "unsafe"]
    if bits.shape != (-(-steps // 8),):  # unpackbits would read missing bits as safe steps
        raise ValueError(f"{prefix}unsafe has shape {bits.shape}, not the bits of {steps} steps")
    unsafe = np.unpackbits(bits, count=steps).astype(bool)
    costs = unsafe.astype(np.float64)
    if prefix + "values" in arrays:
        values = arrays[prefix + "values"]
        if values.shape != (unsafe.sum(),):  # a single value would be broadcast
            raise ValueError(f"{prefix}values has shape {values.shape} for {unsafe.sum()} costs")
        costs[unsafe] = values
    return costs


def digits(numbers: NDArray[np.integer]) -> NDArray[np.uint8]:
    """Split integers >= 0 into bytes [D, ...], lowest first: so separated, they compress better."""
    size = max(1, -(-int(numbers.max(initial=0)).bit_length() // 8))
    return np.array([(numbers >> 8 * k) & 255 for k in range(size)], dtype=np.uint8)


def of_digits(bytes_: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Return the integers [...] that `digits` has split. ValueError: any other array."""
    if bytes_.dtype != np.uint8 or bytes_.ndim < 2 or not 0 < len(bytes_) < 8:
        raise ValueError(f"{bytes_.dtype} {list(bytes_.shape)} are no bytes of whole numbers")
    return np.tensordot(256 ** np.arange(len(bytes_)), bytes_, axes=1)


def records_of(
    arrays: Mapping[str, NDArray], prefix: str, cost: str, threshold: float = 0.0
) -> EpisodeRecords:
    """Return the records of one run and one of its costs, from the arrays of results.npz whose
    names begin with prefix: the cost of each step, or in an archive a row per episode.

    In an archive, returns are (`return` + lowest) / scale, and `return/from` is [lowest, scale].
    `costs/NAME/kind` is an index [E] into the rows of `costs/NAME/kinds` [K, 3]: longest streak,
    cost steps, streaks. `costs/NAME/cost` is left out if each cost step costs 1.
    """
    rollouts, of_cost = arrays[prefix + "rollouts"], f"{prefix}costs/{cost}/"
    ids, length = np.repeat(np.arange(len(rollouts)), rollouts), arrays[prefix + "length"]
    length, reward = length.astype(np.int64), arrays[prefix + "return"]
    if of_cost + "steps" in arrays:
        costs = unpack_costs(arrays, of_cost)
        records = EpisodeRecords.from_costs(costs, length, None, ids, threshold)
        return replace(records, reward=reward)
    if threshold:
        raise ValueError("holds streaks, not costs of steps: leave the threshold out")
    lowest, scale = arrays[prefix + "return/from"].tolist()
    reward = (of_digits(reward) + lowest) / scale
    streaks, cost_steps, count = arrays[of_cost + "kinds"][of_digits(arrays[of_cost + "kind"])].T
    sums = arrays.get(of_cost + "cost", cost_steps)
    last = (streaks, cost_steps, count)
    return EpisodeRecords(ids, np.cumsum(length) - length, length, reward, sums, *last)


def check_records(records: Any, name: str = "records", fewest: int = 1) -> None:
    """Raise TypeError if these are not EpisodeRecords, ValueError if they have too few rows."""
    if not isinstance(records, EpisodeRecords):
        raise TypeError(f"{name} must be EpisodeRecords, got {type(records).__name__}")
    if len(records) < fewest:
        raise ValueError(f"{name} are empty: no finished trajectory; call end_rollout() first")
