"""Numbers at the precision that pictures and archives need."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

DROPPED = 8
"""Of the 23 bits behind the point of a float32."""


def five_digits(values: ArrayLike) -> NDArray[np.float64]:
    """The nearest numbers of 16 significant bits: off by a part in 65 536 at most.

    Returns of single episodes need no more for anything a report shows: means over hundreds of them
    to three digits. Their other five bytes are noise, which no compression makes smaller. Rounded
    twice is rounded once. Where a number lies beyond float32, all stay as they are.
    """
    exact = np.asarray(values, dtype=np.float64)
    with np.errstate(over="ignore"):
        bits = exact.astype(np.float32).view(np.uint32).astype(np.uint64)
    half, step = np.uint64(1 << (DROPPED - 1)), np.uint64(1 << DROPPED)
    rounded = ((bits + half) // step * step).astype(np.uint32).view(np.float32)
    return rounded.astype(np.float64) if np.isfinite(rounded).all() else exact


def to_planes(values: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Numbers of `five_digits` as three planes of bytes, [3, N], which compress better apart."""
    bits = values.astype("<f4").view(np.uint8).reshape(-1, 4)
    return np.ascontiguousarray(bits[:, 1:].T)


def from_planes(planes: NDArray[np.uint8]) -> NDArray[np.float64]:
    """The numbers that `to_planes` was given."""
    bits = np.zeros((planes.shape[1], 4), np.uint8)
    bits[:, 1:] = planes.T
    return bits.view("<f4").ravel().astype(np.float64)
