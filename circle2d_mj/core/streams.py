"""Random numbers for many environments at once; each environment has its own stream."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import numpy as np
from numpy.typing import NDArray

_MULTIPLIERS = (np.uint64(0xD2511F53), np.uint64(0xCD9E8D57))
_KEY_STEPS = (np.uint64(0x9E3779B9), np.uint64(0xBB67AE85))
_LOW, _SHIFT = np.uint64(0xFFFFFFFF), np.uint64(32)


def philox(keys: NDArray[np.uint64], counters: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Return four random 32-bit words for each key and counter, by Philox4x32-10.

    keys, counters: [n] -> [n, 4], values below 2**32. A NumPy generator holds a single stream, and
    drawing from 4096 generators takes longer than stepping the environments.
    Source: Salmon et al. 2011, "Parallel random numbers: as easy as 1, 2, 3".
    """
    k0, k1 = keys & _LOW, keys >> _SHIFT
    c0, c1 = counters & _LOW, counters >> _SHIFT
    c2, c3 = np.zeros_like(c0), np.zeros_like(c0)
    for _ in range(10):
        product0, product1 = c0 * _MULTIPLIERS[0], c2 * _MULTIPLIERS[1]
        c0, c2 = (product1 >> _SHIFT) ^ c1 ^ k0, (product0 >> _SHIFT) ^ c3 ^ k1
        c1, c3 = product1 & _LOW, product0 & _LOW
        k0, k1 = (k0 + _KEY_STEPS[0]) & _LOW, (k1 + _KEY_STEPS[1]) & _LOW
    return np.stack((c0, c1, c2, c3), axis=-1)


class Streams:
    """Independent streams of uniform numbers, one for each environment.

    keys: [n] uint64, one for each stream. `keys` and `counters` are the whole state.
    """

    def __init__(self, keys: NDArray[np.uint64]) -> None:
        self.keys = keys
        self.counters = np.zeros_like(keys)

    def reseed(self, index: NDArray[np.intp], keys: NDArray[np.uint64]) -> None:
        """Restart the streams `index` with new `keys`."""
        self.keys[index], self.counters[index] = keys, 0

    def uniform(self, index: NDArray[np.intp], draws: int = 1) -> NDArray[np.float64]:
        """Draw the next 4 * draws numbers in (0, 1) of each stream in `index`.

        Returns [len(index), 4 * draws], equal to the results of `draws` calls side by side.
        """
        ahead = np.arange(draws, dtype=np.uint64)
        counters = (self.counters[index][:, None] + ahead).ravel()
        words = philox(np.repeat(self.keys[index], draws), counters)
        self.counters[index] += np.uint64(draws)
        return (words.reshape(len(index), -1).astype(np.float64) + 0.5) / 2.0**32


def keys_of_seeds(seed: int | Sequence[int | None], num_envs: int) -> list[int | None]:
    """Return a key per environment: `seed, seed + 1, ...`, or as given (None: keep the stream).

    Raises TypeError or ValueError for seeds that are not integers, for keys outside [0, 2**64), and
    for a sequence whose length is not `num_envs`.
    """
    if isinstance(seed, (int, np.integer)) and not isinstance(seed, bool):
        keys: list[int | None] = [int(seed) + i for i in range(num_envs)]
    elif isinstance(seed, (str, bytes, bool)) or not hasattr(seed, "__len__"):
        raise TypeError(f"seed must be an integer or a sequence of integers, got {seed!r}")
    else:
        keys = list(cast("Sequence[int | None]", seed))
        if len(keys) != num_envs:
            raise ValueError(f"seed must have one entry per environment ({num_envs}), got {seed!r}")
    for key in keys:
        if key is None:
            continue
        if not isinstance(key, (int, np.integer)) or isinstance(key, bool):
            raise TypeError(f"seed must be an integer or a sequence of integers, got {seed!r}")
        if not 0 <= key < 2**64:
            raise ValueError(f"seed must be in [0, 2**64), got {key!r}")
    return [key if key is None else int(key) for key in keys]  # int() for NumPy's integers
