"""Random numbers of training: a pure function of the run (seed and task), purpose and epoch.

No generator outlives an epoch, so there is no random state to save. What a run draws does not
depend on the runs beside it.
"""

from __future__ import annotations

import enum
import hashlib
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

BLOCK = 64
"""Steps whose numbers are drawn at once; changing it changes the numbers."""


class Purpose(enum.IntEnum):
    """Purposes of random numbers; each run has a separate stream for each purpose."""

    PARAMETERS = 0
    ENVIRONMENT = 1
    EXPLORATION = 2
    UPDATE = 3
    EVALUATION = 4
    RANDOM_ACTIONS = 5
    NOVELTY = 6


def stream_seed(seed: int, task: str) -> int:
    """Return the seed of a run's random streams: a 64-bit digest of its seed and its task's id.

    Runs of equal seeds on different tasks are thus independent trials. The `module:` prefix of the
    id is ignored: it only says where the task is registered.
    """
    name = f"{seed} {task.rpartition(':')[2]}".encode()
    return int.from_bytes(hashlib.blake2b(name, digest_size=8).digest(), "little")


def stream(seed: int, purpose: Purpose, epoch: int = 0) -> np.random.Generator:
    """Return the generator of a run for a purpose in an epoch: Philox, keyed by all three."""
    key = np.array((seed, purpose), dtype=np.uint64)
    return np.random.Generator(np.random.Philox(key=key, counter=(0, 0, 0, epoch)))


def streams(seeds: Sequence[int], purpose: Purpose, epoch: int) -> list[np.random.Generator]:
    """Return the generator of every run."""
    return [stream(seed, purpose, epoch) for seed in seeds]


def environment_seeds(seeds: Sequence[int], purpose: Purpose, epoch: int, each: int) -> list[int]:
    """Return seeds for the resets of an epoch, `each` per run, one run after the other."""
    draws = [rng.integers(2**63, size=each) for rng in streams(seeds, purpose, epoch)]
    return [int(draw) for draw in np.concatenate(draws)]


Draw = Callable[[np.random.Generator, tuple[int, ...]], NDArray[np.float32]]


def normal(rng: np.random.Generator, size: tuple[int, ...]) -> NDArray[np.float32]:
    """Standard normal numbers."""
    return rng.standard_normal(size, dtype=np.float32)


def uniform(rng: np.random.Generator, size: tuple[int, ...]) -> NDArray[np.float32]:
    """Uniform numbers in [-1, 1)."""
    return 2.0 * rng.random(size, dtype=np.float32) - 1.0


def correlated_uniform(
    rng: np.random.Generator, size: tuple[int, ...], exponent: float
) -> NDArray[np.float32]:
    """Numbers in [-1, 1], correlated along the first axis, each with a uniform distribution.

    They are Gaussian noise whose power falls as `frequency ** -exponent`, mapped by the normal
    distribution function: exponent 0 is white, 1 pink, 2 brown. size: (even length, ...). Source:
    Timmer & König 1995, "On generating power law noise".
    """
    import torch  # late: configurations and results need stream seeds, but not torch

    frequency = np.maximum(np.arange(size[0] // 2 + 1), 1) / size[0]
    scale = frequency.reshape(-1, *[1] * (len(size) - 1)) ** (-exponent / 2)
    real, imaginary = scale * rng.standard_normal((2, len(scale), *size[1:]))
    spectrum = real + 1j * imaginary
    spectrum[[0, -1]] = 2**0.5 * spectrum[[0, -1]].real  # for a real series these two are real
    shares = np.full(len(scale), 4.0)  # of the variance; the others count twice
    shares[[0, -1]] = 2.0
    deviation = np.sqrt((shares * scale.ravel() ** 2).sum()) / size[0]
    gaussian = np.fft.irfft(spectrum, size[0], axis=0) / deviation
    return torch.erf(torch.from_numpy(gaussian / 2**0.5)).float().numpy()


def steps_of_noise(
    draw: Draw, seeds: Sequence[int], purpose: Purpose, epoch: int, shape: tuple[int, ...]
) -> Iterator[NDArray[np.float32]]:
    """Yield numbers [R, *shape] from `draw` for each step of an epoch."""
    generators = streams(seeds, purpose, epoch)
    while True:
        yield from np.stack([draw(rng, (BLOCK, *shape)) for rng in generators], axis=1)
