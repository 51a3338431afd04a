"""EMCC, expected maximum consecutive cost steps: how safely an agent explored while it learned.

    costs of steps -> longest streak -> MCC of a rollout -> EMCC of a part of training -> interval

Arrays in, numbers or frozen dataclasses out. numpy is all it imports; gymnasium is imported when
`RecordCosts` is first used.
"""

import importlib
from typing import TYPE_CHECKING, Any

from emcc.interval import Difference, Estimate, difference, estimate
from emcc.parts import cost_rate, emcc_by_part
from emcc.recorder import CostRecorder
from emcc.records import EpisodeRecords
from emcc.streaks import count_streaks, longest_streak, longest_streaks, mcc, streak_bounds
from emcc.tail import cvar, emcc, worst

if TYPE_CHECKING:
    from emcc.statistics import (
        Interval,
        Share,
        bootstrap,
        holm,
        iqm,
        mean_interval,
        permutation_test,
        probability_of_improvement,
        profile,
        share,
    )
    from emcc.streak_cost import StreakCost
    from emcc.wrappers import RecordCosts

__all__ = [
    "CostRecorder",
    "Difference",
    "EpisodeRecords",
    "Estimate",
    "Interval",
    "RecordCosts",
    "Share",
    "StreakCost",
    "bootstrap",
    "cost_rate",
    "count_streaks",
    "cvar",
    "difference",
    "emcc",
    "emcc_by_part",
    "estimate",
    "holm",
    "iqm",
    "longest_streak",
    "longest_streaks",
    "mcc",
    "mean_interval",
    "permutation_test",
    "probability_of_improvement",
    "profile",
    "share",
    "streak_bounds",
    "worst",
]


_LATE = {
    "RecordCosts": "emcc.wrappers",
    "StreakCost": "emcc.streak_cost",
    **dict.fromkeys(
        (
            "Interval",
            "Share",
            "bootstrap",
            "holm",
            "iqm",
            "mean_interval",
            "permutation_test",
            "probability_of_improvement",
            "profile",
            "share",
        ),
        "emcc.statistics",
    ),
}
"""Modules that are imported when one of their names is first used."""


def __getattr__(name: str) -> Any:
    if name in _LATE:
        return getattr(importlib.import_module(_LATE[name]), name)
    raise AttributeError(f"module 'emcc' has no attribute {name!r}")
