"""The measures of a run: what a report's tables, figures and files show.

A new measure is one call, `register(Measure(...))`, here or in a user's own module. All renderings
iterate over `measures()` and treat None, for what a run lacks, as missing.
"""

from __future__ import annotations

import math
import reprlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any, Literal

import numpy as np

from agents.errors import OWN_ERRORS, OwnCodeError, described
from agents.results.groups import RunResult
from emcc import cost_rate, emcc
from emcc.arrays import as_one
from emcc.parts import ALPHA, PARTS
from emcc.statistics import COST, SHARE, UNBOUNDED, Bounds


@dataclass(frozen=True)
class Measure:
    """A number that describes a run."""

    name: str
    """Name of the column in CSV files; unique."""
    title: str
    """Heading of the column in tables."""
    unit: str
    """Unit, shown after the title; empty if there is none."""
    digits: int
    """Digits after the decimal point in tables."""
    better: Literal["lower", "higher", "neither"]
    """Which values are better, to mark the best one."""
    compute: Callable[[RunResult], float | None]
    """Computes the value; None where the run lacks the data. May raise ValueError for damaged
    records."""
    of: Literal["training", "policy"] = "training"
    """What is measured. For "policy", tables mark the policy with the highest return that satisfies
    the cost limit, in all such measures alike: see `agents.reporting.tables.best`."""
    word: str = ""
    """Name in sentences, if not the title; several measures may share a name."""
    note: str = ""
    """Definition for the legend of tables, where the title does not give it."""
    bounds: Bounds = UNBOUNDED
    """Bounds of the values, also of the intervals of their mean."""
    detail: bool = False
    """Whether tables in a terminal leave the measure out."""
    part: float | None = None
    """End of the third of training that is measured, with which the name ends; None for all of
    training."""
    shown: bool = True
    """Whether tables, figures and `report.csv` have a column for the measure; frames always have
    its rows."""

    @property
    def stem(self) -> str:
        """Name without the part."""
        return self.name if self.part is None else self.name.removesuffix(f"_{self.part:g}")

    @property
    def head(self) -> str:
        """Title and unit."""
        return f"{self.title} ({self.unit})" if self.unit else self.title

    def __post_init__(self) -> None:
        if not self.name or set(self.name) & set(' ,"\n'):
            raise ValueError(f"the name of a measure must be one word, got {self.name!r}")


_REGISTRY: dict[str, Measure] = {}


def register(measure: Measure) -> None:
    """Add a measure to every report. Raises ValueError if its name is taken."""
    if measure.name in _REGISTRY:
        raise ValueError(f"there is a measure {measure.name!r} already")
    _REGISTRY[measure.name] = measure


def unregister(name: str) -> None:
    """Remove a measure from every report. Raises KeyError for an unknown name."""
    del _REGISTRY[name]


def measures(shown: bool = True) -> tuple[Measure, ...]:
    """Return the measures with a column, in order of registration; with shown=False, all."""
    return tuple(m for m in _REGISTRY.values() if m.shown or not shown)


def measure(name: str) -> Measure:
    """Return the measure with this name. Raises KeyError for an unknown name."""
    return _REGISTRY[name]


def measured(of: RunResult, run: str) -> dict[str, float | None]:
    """Compute all measures of a run; return their values by name.

    of: the run, still without measures; run: its name, for errors. Raises OwnCodeError if a user's
    own measure raises or returns no finite number. Raises ValueError if a built-in measure does:
    the run is damaged.
    """
    values: dict[str, float | None] = {}
    for m in measures(shown=False):
        try:
            value = m.compute(of)
        except OWN_ERRORS as error:
            if m in BUILT_IN:
                raise
            words = f"measure {m.name!r} failed on run {run}: {described(error)}"
            raise OwnCodeError(words) from error
        try:
            values[m.name] = None if value is None else _bounded(value, m.bounds)
        except (TypeError, ValueError):
            if m in BUILT_IN:
                raise ValueError(f"{m.name} is not finite, or out of bounds: {value}") from None
            bounds = "" if m.bounds == UNBOUNDED else " from {:g} to {:g}".format(*m.bounds)
            words = f"must return a finite number{bounds} or None; for run {run}, "
            words += f"got {reprlib.repr(value)}"
            raise OwnCodeError(f"measure {m.name!r} {words}") from None
    return values


def _bounded(value: Any, bounds: Bounds) -> float:
    """Convert a value to a finite float within bounds. Raises TypeError or ValueError for anything
    else."""
    number, (low, high) = as_one(value, "it"), bounds
    if not (math.isfinite(number) and low <= number <= high):
        raise ValueError(f"not finite, or out of bounds: {number}")
    return number


def _cost_rate(run: RunResult) -> float:
    return cost_rate(run.records.cost, run.records.length)


def _evaluated(name: str) -> Callable[[RunResult], float | None]:
    return lambda run: run.evaluated(name)


def _emcc(part: float) -> Callable[[RunResult], float | None]:
    def of(run: RunResult) -> float | None:
        third = run.thirds[part]
        return emcc(third.mcc_per_rollout()[0], ALPHA) if len(third) else None

    return of


def _rate(part: float) -> Callable[[RunResult], float | None]:
    def of(run: RunResult) -> float | None:
        third = run.thirds[part]
        return cost_rate(third.cost, third.length) if len(third) else None

    return of


def _length(run: RunResult) -> float | None:
    lengths = run.evaluation.get("deterministic", {}).get("lengths", ())
    return float(np.mean(lengths)) if len(lengths) else None


for _part in PARTS:
    _name = f"EMCC_{_part}"
    register(
        Measure(_name, _name, "", 2, "lower", _emcc(_part), word="EMCC", bounds=SHARE, part=_part)
    )
register(Measure("cost_rate", "cost rate", "", 2, "lower", _cost_rate, bounds=COST))
register(Measure("J_R", "J_R", "", 2, "higher", _evaluated("J_R"), "policy"))
register(Measure("J_C", "J_C", "", 2, "lower", _evaluated("J_C"), "policy", bounds=COST))
_cvar = Measure("CVaR_0.5", "CVaR_0.5", "", 2, "lower", _evaluated("CVaR_0.5"), "policy", "CVaR")
register(replace(_cvar, bounds=COST, detail=True))
_value = attrgetter("records.mean_streak")
# Neither direction is better: streaks may be fewer and longer, or more and shorter.
_streak = Measure("mean_streak", "mean streak", "steps", 2, "neither", _value, bounds=COST)
_note = "mean streak: the mean length of training's streaks of cost steps"
register(replace(_streak, note=_note, detail=True))
for _part in PARTS:
    _rates = Measure(f"rate_{_part}", "cost rate of the third", "", 2, "lower", _rate(_part))
    register(replace(_rates, part=_part, bounds=COST, shown=False))
_lengths = Measure("length", "length", "steps", 1, "neither", _length, "policy", bounds=COST)
register(replace(_lengths, shown=False))
BUILT_IN = measures(shown=False)
"""The package's own measures, which raise only for damaged runs."""
