"""Random numbers of training: a pure function of run seed, purpose and epoch.

No generator outlives an epoch, so there is no random state to save, and what a run draws does not
depend on the runs beside it.
"""

from __future__ import annotations

import enum
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray


class Purpose(enum.IntEnum):
    """What random numbers are for; each purpose of each run has a stream of its own."""

    PARAMETERS = 0
    ENVIRONMENT = 1
    EXPLORATION = 2
    UPDATE = 3
    EVALUATION = 4


def stream(seed: int, purpose: Purpose, epoch: int = 0) -> np.random.Generator:
    """The generator of one run for one purpose in one epoch: Philox keyed by all three."""
    return np.random.Generator(np.random.Philox(key=(seed, purpose), counter=(0, 0, 0, epoch)))


def environment_seeds(seeds: Sequence[int], purpose: Purpose, epoch: int, each: int) -> list[int]:
    """Seeds for the resets of an epoch, `each` of them a run, one run after the other."""
    draws = [stream(seed, purpose, epoch).integers(2**63, size=each) for seed in seeds]
    return [int(draw) for draw in np.concatenate(draws)]


def steps_of_noise(
    seeds: Sequence[int], purpose: Purpose, epoch: int, shape: tuple[int, ...], block: int = 64
) -> Iterator[tuple[NDArray[np.float32], NDArray[np.float32]]]:
    """For each step of an epoch standard normal and uniform (-1, 1) numbers, both [R, *shape]."""
    streams = [stream(seed, purpose, epoch) for seed in seeds]
    while True:
        size = (block, *shape)
        normal = np.stack([s.standard_normal(size, dtype=np.float32) for s in streams], axis=1)
        uniform = np.stack([s.random(size, dtype=np.float32) for s in streams], axis=1)
        yield from zip(normal, 2.0 * uniform - 1.0, strict=True)
