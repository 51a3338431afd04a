"""Logs of other libraries: Stable-Baselines3's monitor files, progress.csv of OmniSafe and SafePO.

They hold sums of episodes or means of epochs, which cannot give EMCC.
"""

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from emcc.arrays import check_range
from emcc.csv_columns import Columns, parse
from emcc.inputs import EpisodeSums, EpochMeans
from emcc.streaks import streak_bounds

FILES = ("progress.csv", "*monitor.csv")
"""Names of such files, as their libraries write them."""
TOTAL_STEPS = {"TotalEnvSteps": "OmniSafe", "Train/TotalSteps": "SafePO"}
"""Column of the environment steps so far, and the library that names it so."""


def is_monitor(columns: Collection[str]) -> bool:
    """Whether these are the columns of a monitor file of Stable-Baselines3."""
    return {"r", "l", "t"} <= set(columns)


def is_progress(columns: Collection[str]) -> bool:
    """Whether these are the columns of a progress.csv of OmniSafe or SafePO."""
    return "Metrics/EpCost" in columns or "Metrics/EpRet" in columns


def read_monitor(columns: Columns) -> EpisodeSums:
    """A monitor file whose columns have been read.

    The column `cost` is info["cost"] of each episode's last step unless the environment sums it; a
    cost above 1 tells that it does, since costs of steps are 0 or 1 where sums give bounds.
    ValueError: no column `cost`, or one that may not hold sums.
    """
    advice = "train with emcc.sb3.EMCCCallback, which records the cost of every step"
    if "cost" not in columns:
        raise ValueError(
            f"{columns.path}: a monitor file of Stable-Baselines3 without costs (columns "
            f"{', '.join(columns)}): {advice}"
        )
    sums = sums_of(columns, "cost", "l")
    if sums.cost.max() <= 1:
        raise ValueError(
            f"{columns.path}, column cost: no cost exceeds 1, so they are those of each episode's "
            f"last step, not sums: {advice}"
        )
    return sums


def sums_of(columns: Columns, cost: str, length: str) -> EpisodeSums:
    """Sums of episodes, from the columns of their costs and lengths.

    ValueError: no rows, or sums that are no sums of costs 0 or 1.
    """
    costs, lengths = (parse(columns, name, float) for name in (cost, length))
    if not costs.size:
        raise ValueError(f"{columns.path}: no episodes")
    try:
        streak_bounds(costs, lengths)
    except ValueError as error:
        raise ValueError(
            f"{columns.path}: sums of 0/1 costs are needed for bounds: {error}"
        ) from None
    return EpisodeSums(columns.path, costs, lengths.astype(np.int64))


def read_progress(columns: Columns) -> EpochMeans:
    """A progress.csv whose columns have been read.

    ValueError: a column is missing, a value is negative or not finite, steps do not rise.
    """
    path = columns.path
    steps = [name for name in TOTAL_STEPS if name in columns]
    needed = ["Metrics/EpCost", "Metrics/EpLen", *(steps[:1] or [" or ".join(TOTAL_STEPS)])]
    if missing := [name for name in needed if name not in columns]:
        raise ValueError(f"{path}: a log of means of epochs without {', '.join(missing)}")
    cost, length, total = (parse(columns, name, float) for name in needed)
    if not cost.size:
        raise ValueError(f"{path}: no epochs")
    for name, values, low in zip(needed, (cost, length, total), (0, 1, 1), strict=True):
        check_range(values, f"{path}, column {name}", low)
    if (np.diff(total, prepend=0) <= 0).any():
        raise ValueError(f"{path}, column {needed[2]}: the steps must rise from row to row")
    return EpochMeans(path, cost, length, _whole(total))


def _whole(values: NDArray) -> NDArray[np.int64]:
    return values.astype(np.int64)  # some loggers write 1e6 or 20000.0
