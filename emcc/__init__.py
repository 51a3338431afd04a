"""EMCC, expected maximum consecutive cost steps: how safely an agent explored while it learned.

    costs of steps -> longest streak -> MCC of a rollout -> EMCC of a part of training -> interval

Arrays in, numbers or frozen dataclasses out. The core imports only numpy. Costs can come from other
libraries: `RecordCosts` wraps an environment of gymnasium, `sb3.EMCCCallback` follows a
training of Stable-Baselines3, `from_tensordict` reads TorchRL's batches, `from_minari` a data set.
`read` takes what `python -m emcc` takes. `panel` puts EMCC beside the measures that
other papers report.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from emcc.datasets import from_minari, from_tensordict
from emcc.interval import Difference, Estimate, difference, estimate
from emcc.measures import regret_curve
from emcc.panels import Panel, panel
from emcc.parts import cost_rate, emcc_by_part
from emcc.permutation import equivalence_test, holm, permutation_test
from emcc.readers import read
from emcc.recorder import CostRecorder
from emcc.records import EpisodeRecords
from emcc.statistics import (
    Interval,
    Share,
    bootstrap,
    iqm,
    mean_difference,
    mean_interval,
    probability_of_improvement,
    profile,
    share,
)
from emcc.streaks import count_streaks, longest_streak, longest_streaks, mcc, streak_bounds
from emcc.tail import cvar, emcc, worst

if TYPE_CHECKING:
    from emcc import sb3
    from emcc.streak_cost import StreakCost
    from emcc.wrappers import RecordCosts

__all__ = [
    "CostRecorder",
    "Difference",
    "EpisodeRecords",
    "Estimate",
    "Interval",
    "Panel",
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
    "equivalence_test",
    "estimate",
    "from_minari",
    "from_tensordict",
    "holm",
    "iqm",
    "longest_streak",
    "longest_streaks",
    "mcc",
    "mean_difference",
    "mean_interval",
    "panel",
    "permutation_test",
    "probability_of_improvement",
    "profile",
    "read",
    "regret_curve",
    "sb3",
    "share",
    "streak_bounds",
    "worst",
]


_OF_GYMNASIUM = {
    "RecordCosts": ("emcc.wrappers", "gymnasium>=0.28"),
    "StreakCost": ("emcc.streak_cost", "gymnasium>=1.1"),
}
"""Names, by the module that has them and the version of gymnasium that it takes."""


def __getattr__(name: str) -> Any:
    if name == "sb3":  # late, because it needs stable-baselines3
        return import_module("emcc.sb3")
    if name in _OF_GYMNASIUM:
        module, needed = _OF_GYMNASIUM[name]
        try:
            return getattr(import_module(module), name)
        except ImportError as error:  # gymnasium is missing, or too old to have a name
            if (error.name or "").partition(".")[0] != "gymnasium":
                raise
            raise ImportError(
                f"emcc.{name} needs {needed}: pip install '{needed}'; without it, "
                "emcc.CostRecorder takes the costs of steps"
            ) from None
    raise AttributeError(f"module 'emcc' has no attribute {name!r}")
