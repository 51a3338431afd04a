"""EMCC, expected maximum consecutive cost steps: how safely an agent explored while it learned.

    costs of steps -> longest streak -> MCC of a rollout -> EMCC of a part of training -> interval

Arrays in, numbers or frozen dataclasses out. numpy is all it imports; gymnasium is imported when
`RecordCosts` is first used.
"""

from typing import TYPE_CHECKING, Any

from emcc.interval import Difference, Estimate, difference, estimate
from emcc.parts import cost_rate, emcc_by_part
from emcc.recorder import CostRecorder
from emcc.records import EpisodeRecords
from emcc.streaks import count_streaks, longest_streak, longest_streaks, mcc, streak_bounds
from emcc.tail import cvar, emcc, worst

if TYPE_CHECKING:
    from emcc.wrappers import RecordCosts

__all__ = [
    "CostRecorder",
    "Difference",
    "EpisodeRecords",
    "Estimate",
    "RecordCosts",
    "cost_rate",
    "count_streaks",
    "cvar",
    "difference",
    "emcc",
    "emcc_by_part",
    "estimate",
    "longest_streak",
    "longest_streaks",
    "mcc",
    "streak_bounds",
    "worst",
]


def __getattr__(name: str) -> Any:
    if name == "RecordCosts":  # late, because it needs gymnasium
        from emcc.wrappers import RecordCosts

        return RecordCosts
    raise AttributeError(f"module 'emcc' has no attribute {name!r}")
