"""Contents of a file of costs: a training run, sums of episodes, or means of epochs."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from emcc.records import EpisodeRecords

RECORDED = "recorded"
"""Where total steps come from that nobody planned."""


@dataclass(frozen=True, eq=False)
class Run:
    """One training run."""

    path: Path
    records: EpisodeRecords
    total_steps: int  # planned, as far as known
    total_from: str = RECORDED
    task: str = ""
    algorithm: str = ""
    seed: str = ""
    settings: str = ""  # the other settings that runs of one experiment have in common
    note: str = ""  # how the file was read, where that is a guess

    @property
    def steps(self) -> int:
        """Environment steps recorded."""
        return self.records.total_steps

    @cached_property
    def rollouts(self) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """[D] MCC and start steps."""
        return self.records.mcc_per_rollout()


@dataclass(frozen=True, eq=False)
class EpisodeSums:
    """Episodes known by their sums only: [E] costs and lengths. They have no EMCC."""

    contents: ClassVar[str] = "sums of episodes"
    path: Path
    cost: NDArray[np.float64]
    """Each the number of cost steps, since costs are 0 or 1."""
    length: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class EpochMeans:
    """Epochs known by the means of their episodes only: arrays [K]. They have no EMCC."""

    contents: ClassVar[str] = "means of epochs"
    path: Path
    cost: NDArray[np.float64]
    """Mean cost of an episode."""
    length: NDArray[np.float64]
    """Mean length of an episode, in steps."""
    total_steps: NDArray[np.int64]
    """Environment steps up to the end of the epoch."""
