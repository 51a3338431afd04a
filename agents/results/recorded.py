"""Statistics, for tables, of a number that a task recorded at each step, computed from the steps or
read from an archive, which keeps no steps."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.training.derive import three_digits
from emcc import EpisodeRecords, longest_streaks
from emcc.panels import emcc_of_thirds
from emcc.parts import PARTS, rollouts_by_part

Above = Callable[[float], dict[float, float | None]]


class Recorded(NamedTuple):
    """Statistics of a number recorded at each step of a run.

    Rows of the arrays are the three thirds of training and the steps that are in no third."""

    lowest: float
    """The smallest value over all steps."""
    steps: NDArray[np.int64]
    """[4]: number of steps"""
    values: NDArray[np.float64]
    """[V]: the distinct values above 0, to three digits, ascending"""
    counts: NDArray[np.int64]
    """[4, V]: number of steps with each value"""
    most: NDArray[np.float64]
    """[4]: the largest value, exact; at least 0"""
    emcc_above: Above
    """EMCC of each third, where a step costs if its number is above the given threshold; an archive
    rounds the threshold down to two digits. None where no rollout starts in the third, and for
    windows of episodes in an archive."""

    def above_0(self, row: int | slice = slice(None)) -> NDArray[np.float64]:
        """Return the values above 0 of one row, or of all, to three digits."""
        return np.repeat(self.values, np.atleast_2d(self.counts[row]).sum(axis=0))


def of_steps(values: NDArray[np.float64], records: EpisodeRecords, window: int | None) -> Recorded:
    """Compute the statistics from the values of steps.

    values: [steps]. records: of the run. window: episodes per window for EMCC; None: rollouts."""
    parts = [*rollouts_by_part(np.arange(len(values)), len(values)).values()]
    rows = [values[part] for part in (*parts, ~np.any(parts, axis=0))]
    rounded = [three_digits(row[row > 0]) for row in rows]
    different = np.unique(np.concatenate(rounded))
    found = (np.searchsorted(different, row) for row in rounded)
    counts = np.array([np.bincount(row, minlength=len(different)) for row in found])
    most = np.array([row.max(initial=0.0) for row in rows])
    above = functools.partial(_emcc_above, values, records.length, records, window)
    sizes = np.array([*map(len, rows)])
    return Recorded(float(values.min(initial=0.0)), sizes, different, counts, most, above)


def _emcc_above(
    values: NDArray[np.float64],
    lengths: NDArray[np.int64],
    records: EpisodeRecords,
    window: int | None,
    threshold: float,
) -> dict[float, float | None]:
    """Return EMCC by third for values above the threshold; lengths: values per episode."""
    streaks = longest_streaks(values, lengths, threshold)
    changed = replace(records, longest_streak=streaks, cost_steps=None, streaks=None)
    return emcc_of_thirds(changed, records.total_steps, window=window)


def packed(values: NDArray[np.float64], records: EpisodeRecords) -> dict[str, NDArray]:
    """Return the arrays that an archive keeps of a recorded number; `unpacked` reads them."""
    told = of_steps(values, records, None)
    kept = {name: np.array(getattr(told, name)) for name in ("lowest", "steps", "most")}
    if told.lowest < 0:  # tables show no more than this
        return kept
    kept |= {"values": told.values.astype(np.float32), "counts": told.counts.astype(np.int32)}
    # Of the steps at 0, one after each streak and one in each episode are enough.
    first = np.cumsum(records.length) - records.length
    needed = (values > 0) | np.append(True, values[:-1] > 0)
    needed[first] = True
    lengths = np.add.reduceat(needed, first, dtype=np.int64)
    positive = values[values > 0]
    thresholds = two_digits(positive.min(), positive.max()) if len(positive) else np.zeros(1)
    above = functools.partial(_emcc_above, values[needed], lengths, records, None)
    rows = [[*above(threshold).values()] for threshold in thresholds.tolist()]
    return kept | {"thresholds": thresholds, "emcc": np.array(rows, dtype=float)}


def two_digits(least: float, most: float) -> NDArray[np.float64]:
    """Return 0 and all two-digit numbers from `least`, rounded down, to `most`, rounded up, both
    above 0."""
    powers = range(math.floor(math.log10(least)) - 1, math.floor(math.log10(most)) + 2)
    numbers = np.array([float(f"{k}e{power - 1}") for power in powers for k in range(10, 100)])
    first, last = np.searchsorted(numbers, least, "right") - 1, np.searchsorted(numbers, most)
    return np.append(0.0, numbers[first : last + 1])


def unpacked(arrays: Mapping[str, NDArray], prefix: str, window: int | None) -> Recorded:
    """Read the statistics that `packed` wrote from an archive's arrays; prefix: of their names."""
    lowest, steps, most = (arrays[prefix + name] for name in ("lowest", "steps", "most"))
    nothing = np.zeros((len(PARTS) + 1, 0))
    values = three_digits(arrays.get(prefix + "values", nothing[0]))
    counts = arrays.get(prefix + "counts", nothing).astype(np.int64)
    if counts.shape != (len(steps), len(values)) or len(steps) != len(nothing):
        raise ValueError(f"{prefix}counts has shape {list(counts.shape)} for {len(values)} values")

    def above(threshold: float) -> dict[float, float | None]:
        if window is not None:
            return dict.fromkeys(PARTS)
        thresholds, emcc = arrays[prefix + "thresholds"], arrays[prefix + "emcc"]
        row = np.searchsorted(thresholds, threshold * (1 + 1e-9), "right") - 1
        told = (None if np.isnan(value) else float(value) for value in emcc[row])
        return dict(zip(PARTS, told, strict=True))

    return Recorded(float(lowest), steps, values, counts, most, above)
