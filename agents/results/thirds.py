"""Cost rate, EMCC and MCC of the rollouts of a run in each third of its training."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.results.reading import Group
from emcc import EpisodeRecords, cost_rate, emcc
from emcc.parts import ALPHA, PARTS, rollouts_by_part


class Third(NamedTuple):
    """A run in a third of its training: of the rollouts that start in it."""

    cost_rate: float
    """Cost per step."""
    emcc: float
    """With `ALPHA`."""
    mcc: NDArray[np.float64]
    """Of each rollout."""


def thirds(records: EpisodeRecords, steps: int) -> dict[float, Third]:
    """The thirds of a training by their end, as in `emcc.parts.PARTS`.

    steps: of the whole training. ValueError where no rollout starts in a third.
    """
    mcc, starts = records.mcc_per_rollout()
    _, rollout = np.unique(records.rollout, return_inverse=True)
    found = {}
    for part, chosen in rollouts_by_part(starts, steps).items():
        episodes = chosen[rollout]
        rate = cost_rate(records.cost[episodes], records.length[episodes])
        found[part] = Third(rate, emcc(mcc[chosen], ALPHA), mcc[chosen])
    return found


def of_group(group: Group) -> dict[float, list[Third]]:
    """The thirds of each run of a group."""
    runs = [thirds(run.records, group.config.steps) for run in group.runs]
    return {part: [of_run[part] for of_run in runs] for part in PARTS}
