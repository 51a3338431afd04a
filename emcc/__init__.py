"""EMCC, expected maximum consecutive cost steps: how safely an agent explored while it learned.

    costs of steps -> longest streak -> MCC of a rollout -> EMCC of a part of training -> interval

Functions take arrays and return numbers or frozen dataclasses. The core imports only numpy. Costs
can come from other libraries: `RecordCosts` wraps a Gymnasium environment, `sb3.EMCCCallback`
follows a training of Stable-Baselines3, `from_tensordict` reads TorchRL's batches, and
`from_minari` reads a Minari data set. `read` reads the same files and folders as `python -m emcc`.
`panel` reports EMCC beside the measures that other papers report.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from emcc.parts import cost_rate, cvar, emcc, emcc_by_part, worst
from emcc.records import EpisodeRecords
from emcc.streaks import count_streaks, longest_streak, longest_streaks, mcc, streak_bounds

if TYPE_CHECKING:
    from emcc import sb3
    from emcc.panels import Panel, panel
    from emcc.recorder import CostRecorder
    from emcc.sources import from_minari, from_tensordict, read
    from emcc.statistics import (
        Interval,
        Share,
        bootstrap,
        equivalence_test,
        holm,
        iqm,
        mean_difference,
        mean_interval,
        permutation_test,
        probability_of_improvement,
        profile,
        share,
    )
    from emcc.streak_cost import LongestStreak, StreakCost
    from emcc.wrappers import RecordCosts

# fmt: off
__all__ = [
    "CostRecorder", "EpisodeRecords", "Interval", "LongestStreak", "Panel", "RecordCosts",
    "Share", "StreakCost", "bootstrap", "cost_rate", "count_streaks", "cvar", "emcc",
    "emcc_by_part", "equivalence_test", "from_minari", "from_tensordict", "holm", "iqm",
    "longest_streak", "longest_streaks", "mcc", "mean_difference", "mean_interval", "panel",
    "permutation_test", "probability_of_improvement", "profile", "read", "sb3", "share",
    "streak_bounds", "worst",
]
# fmt: on

_LATE = {
    "panels": ("Panel", "panel"),
    "recorder": ("CostRecorder",),
    "sb3": ("sb3",),
    "sources": ("from_minari", "from_tensordict", "read"),
    "statistics": (
        *("Interval", "Share", "bootstrap", "equivalence_test", "holm", "iqm", "mean_difference"),
        *("mean_interval", "permutation_test", "probability_of_improvement", "profile", "share"),
    ),
    "streak_cost": ("LongestStreak", "StreakCost"),
    "wrappers": ("RecordCosts",),
}
"""Public names by the module that defines them; each module is imported on the first access."""
_NEEDS = {"wrappers": "gymnasium>=0.28", "streak_cost": "gymnasium>=1.1"}
"""Packages that a module needs besides numpy."""


def __getattr__(name: str) -> Any:
    module = next((module for module, names in _LATE.items() if name in names), None)
    if module is None:
        raise AttributeError(f"module 'emcc' has no attribute {name!r}")
    try:
        loaded = import_module(f"emcc.{module}")
        return loaded if name == module else getattr(loaded, name)
    except ImportError as error:  # gymnasium is missing or too old
        needed = _NEEDS.get(module)
        if needed is None or (error.name or "").partition(".")[0] != "gymnasium":
            raise
        raise ImportError(f"emcc.{name} needs {needed}: pip install '{needed}'") from error
