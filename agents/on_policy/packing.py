"""Episodes of each run laid end to end, in blocks whose size does not depend on any run.

Runs whose episodes have different lengths share arrays; rows of weight 0 fill the rest. Sums go
over one block after another, so that a run's sums are the same, bit for bit, however many rows the
other runs have.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from agents.lockstep.backend import tensor

BLOCK = 512
"""Rows of a block: a multiple of 32 (see `nets`) that holds the paper's epoch of 500 steps."""


class Packing:
    """Where the steps of N = R·E episodes side by side lie, run by run."""

    def __init__(self, during: NDArray[np.bool_], runs: int) -> None:
        """during: [T, N], which steps belong to the episodes."""
        self._during = during.T
        self.steps = self._during.reshape(runs, -1).sum(axis=1)
        """Steps of each run, [R]."""
        self.size = max(1, -(-int(self.steps.max()) // BLOCK)) * BLOCK
        """Rows of each run, padding included."""
        self._run = np.repeat(np.arange(runs), self.steps)
        starts = np.cumsum(self.steps) - self.steps
        self._row = np.arange(len(self._run)) - starts[self._run]

    def pack(self, values: NDArray) -> NDArray[np.float32]:
        """[T, N, ...] -> [R, size, ...]; rows beyond a run's steps are 0."""
        packed = np.zeros((len(self.steps), self.size, *values.shape[2:]), dtype=np.float32)
        packed[self._run, self._row] = values.swapaxes(0, 1)[self._during]
        return packed

    def unpack(self, packed: NDArray) -> NDArray[np.float64]:
        """[R, size] -> [T, N]; 0 outside the episodes."""
        values = np.zeros(self._during.shape)
        values[self._during] = packed[self._run, self._row]
        return values.T

    @property
    def weight(self) -> NDArray[np.float32]:
        """[R, size]: `1 / steps` in a run's own rows, so that sums of weighted rows are means."""
        rows = np.arange(self.size) < self.steps[:, None]
        return (rows / np.maximum(self.steps, 1)[:, None]).astype(np.float32)


def blocks(*columns: Tensor) -> Iterator[tuple[Tensor, ...]]:
    """The columns [R, size, ...] in blocks [R, BLOCK, ...]."""
    for start in range(0, columns[0].shape[1], BLOCK):
        yield tuple(column[:, start : start + BLOCK].contiguous() for column in columns)


def minibatches(
    steps: NDArray[np.int64], size: int, streams: list[np.random.Generator]
) -> Iterator[tuple[Tensor, Tensor]]:
    """One pass over the rows of each run in an order of its own: rows [R, size], weights [R, size].

    The weights of a run's minibatch add up to 1, or to 0 where it has no rows left.
    """
    count = -(-int(steps.max()) // size)
    order = np.zeros((len(steps), count * size), dtype=np.int64)
    for run, (n, rng) in enumerate(zip(steps, streams, strict=True)):
        order[run, :n] = rng.permutation(n)
    held = np.arange(count * size) < steps[:, None]
    for start in range(0, count * size, size):
        part = slice(start, start + size)
        here = held[:, part]
        weight = here / np.maximum(here.sum(axis=1, keepdims=True), 1)
        yield tensor(order[:, part]), tensor(weight.astype(np.float32))
