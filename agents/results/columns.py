"""The records of a run as few and small arrays."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.results.precision import five_digits, from_planes, to_planes
from emcc import EpisodeRecords, count_streaks, longest_streaks

FROM_COSTS = ("cost", "longest_streak", "cost_steps", "streaks")
"""Columns that the costs of steps give."""


class Arrays(NamedTuple):
    """Arrays by name, read when they are asked for."""

    has: Callable[[str], bool]
    read: Callable[[str], NDArray]

    def get(self, name: str) -> NDArray | None:
        """An array; None where there is none."""
        return self.read(name) if self.has(name) else None


def pack_costs(costs: NDArray[np.float64]) -> dict[str, NDArray]:
    """Costs of steps: a bit each, and the values where some are neither 0 nor 1."""
    unsafe = costs != 0
    packed = {"unsafe": np.packbits(unsafe), "steps": np.array(len(costs))}
    if (costs[unsafe] != 1).any():
        packed["unsafe_costs"] = costs[unsafe]
    return packed


def unpack_costs(arrays: Arrays) -> NDArray[np.float64]:
    """The costs that `pack_costs` was given."""
    steps = int(arrays.read("steps"))
    unsafe = np.unpackbits(arrays.read("unsafe"), count=steps).astype(bool)
    costs = unsafe.astype(np.float64)
    values = arrays.get("unsafe_costs")
    if values is not None:
        costs[unsafe] = values
    return costs


def pack_records(records: EpisodeRecords, costs: NDArray[np.float64] | None) -> dict[str, NDArray]:
    """The columns of a run's records that do not follow from others.

    costs: of all its steps, [steps]; None where they were not recorded.
    """
    packed: dict[str, NDArray] = {
        "rollout": _smallest(np.diff(records.rollout, prepend=0)),
        "length": _smallest(records.length),
    }
    if not np.array_equal(records.start_step, _starts(records.length)):
        packed["start_step"] = _smallest(records.start_step)
    returns = five_digits(records.reward)
    planes = to_planes(returns)
    exact = np.array_equal(from_planes(planes), returns)
    packed |= {"return_bytes": planes} if exact else {"return": returns}
    derived = {} if costs is None else _from_costs(costs, records.length)
    for name in FROM_COSTS:
        column = getattr(records, name)
        if column is None:
            packed["without_streaks"] = np.array(True)
        elif name not in derived or not np.array_equal(column, derived[name]):
            packed[name] = column if name == "cost" else _smallest(column)
    return packed


def unpack_records(arrays: Arrays, costs: NDArray[np.float64] | None) -> EpisodeRecords:
    """The records that `pack_records` was given, the returns to five digits."""
    length = arrays.read("length").astype(np.int64)
    start, returns = arrays.get("start_step"), arrays.get("return")
    derived = {} if costs is None else _from_costs(costs, length)
    found = {}
    for name in FROM_COSTS:
        stored = arrays.get(name)
        found[name] = derived.get(name) if stored is None else stored
    if arrays.has("without_streaks"):
        found["cost_steps"] = found["streaks"] = None
    return EpisodeRecords(
        np.cumsum(arrays.read("rollout"), dtype=np.int64),
        _starts(length) if start is None else start,
        length,
        from_planes(arrays.read("return_bytes")) if returns is None else returns,
        **found,
    )


def _from_costs(costs: NDArray[np.float64], length: NDArray[np.int64]) -> dict[str, NDArray]:
    cost_steps, streaks = count_streaks(costs, length)
    return {
        "cost": np.add.reduceat(costs, _starts(length)),
        "longest_streak": longest_streaks(costs, length),
        "cost_steps": cost_steps,
        "streaks": streaks,
    }


def _starts(length: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.cumsum(length) - length


def _smallest(values: NDArray[np.int64]) -> NDArray:
    """Integers in the smallest type that holds them."""
    for kind in (np.uint8, np.uint16, np.int32):
        if np.array_equal(values.astype(kind), values):
            return values.astype(kind)
    return values
