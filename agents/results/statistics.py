"""Statistics over the runs of a group, and of two groups, as numbers.

A measure that one of the runs lacks (None) has no mean over them: it is None too. Each number has a
random generator of its own: none depends on which others are asked for.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

import emcc
from agents.results.measures import Measure, measure
from agents.results.reading import Group
from emcc import Interval, Share
from emcc.statistics import FEWEST_RUNS, UNBOUNDED, Bounds

Key = TypeVar("Key", bound=Hashable)
Values = Sequence[float | None]

LEVEL = 0.05
"""Of every test: p values up to it tell a difference."""
INTERVALS = (
    "[95 % t interval over seeds], or the range of the seeds where there are fewer than "
    f"{FEWEST_RUNS} or they end in different places, since no interval of such a mean holds"
)
"""The intervals of means in words. They end where no value can be beyond: a cost at 0."""


def known(values: Values) -> list[float] | None:
    """The values, or None where there are none or one is unknown."""
    found = [value for value in values if value is not None]
    return found if found and len(found) == len(values) else None


def mean_of(values: Values, one_place: bool = True, bounds: Bounds = UNBOUNDED) -> Interval | None:
    """Mean over runs with its 95 % t interval; with its range where there are fewer than five.

    one_place: whether all end in the same place; the mean of others has its range too. bounds: see
    `emcc.mean_interval`.
    """
    found = known(values)
    if found is None:
        return None
    mean = emcc.mean_interval(found, bounds=bounds)
    if one_place or mean.kind == "range":
        return mean
    return replace(mean, low=min(found), high=max(found), kind="range")


def iqm_of(values: Values) -> float | None:
    """Interquartile mean over runs."""
    found = known(values)
    return None if found is None else emcc.iqm(found)


def difference_of(a: Values, b: Values, one_place: bool = True) -> Interval | None:
    """Mean over the runs of `b` less that over `a`, with Welch's 95 % t interval.

    None for its ends where a side has fewer than five runs, or not one_place: not all runs of
    either side end in one place.
    """
    of_a, of_b = known(a), known(b)
    if of_a is None or of_b is None:
        return None
    found = emcc.mean_difference(of_a, of_b)
    return found if one_place else replace(found, low=None, high=None, kind="range")


def p_of(a: Values, b: Values) -> float | None:
    """P value of the permutation test; None where a side has fewer than two runs."""
    sides = _two_sides(a, b)
    return sides and emcc.permutation_test(*sides, rng=np.random.default_rng(0))


def equivalence_of(a: Values, b: Values, margin: float) -> float | None:
    """P value of the equivalence test; None where a side has fewer than two runs."""
    sides = _two_sides(a, b)
    return sides and emcc.equivalence_test(*sides, margin, rng=np.random.default_rng(0))


def _two_sides(a: Values, b: Values) -> tuple[list[float], list[float]] | None:
    of_a, of_b = known(a), known(b)
    if of_a is None or of_b is None or min(len(of_a), len(of_b)) < 2:
        return None
    return of_a, of_b


def improvement_of(a: Values, b: Values, of: Measure) -> Interval | None:
    """Probability that a run of `b` is better than one of `a`, with its bootstrap interval.

    None for a measure of which neither direction is better.
    """
    of_a, of_b = known(a), known(b)
    if of_a is None or of_b is None or of.better == "neither":
        return None
    sides = (of_a, of_b) if of.better == "lower" else (of_b, of_a)
    rng = np.random.default_rng(0)
    return emcc.bootstrap(emcc.probability_of_improvement, *sides, rng=rng)


def corrected(p_values: Mapping[Key, float | None]) -> dict[Key, float | None]:
    """P values corrected for their number by Holm's method; those not known stay so."""
    keys = [key for key, p in p_values.items() if p is not None]
    found = emcc.holm([p for p in p_values.values() if p is not None]) if keys else ()
    return dict(p_values) | {key: float(p) for key, p in zip(keys, found, strict=True)}


def group_mean(group: Group, name: str) -> Interval | None:
    """Mean of a measure over a group's runs: see `mean_of`."""
    return mean_of(group.values(name), group.one_place, measure(name).bounds)


def group_difference(a: Group, b: Group, name: str) -> Interval | None:
    """Difference of the means of a measure, B - A: see `difference_of`."""
    one_place = a.one_place and b.one_place
    return difference_of(a.values(name), b.values(name), one_place)


def places(group: Group) -> dict[str, Share]:
    """Share of a group's runs that end in each place, by each way there, the most frequent first;
    empty without."""
    ends = [run.place for run in group.runs if run.place]
    counted = sorted(dict.fromkeys(ends), key=lambda place: -ends.count(place))
    return {place: emcc.share(ends.count(place), len(group.runs)) for place in counted}


def within_limit(group: Group, limit: float | None) -> Share | None:
    """Share of a group's runs whose J_C is at most the limit; None where that is not known."""
    costs = known(group.values("J_C"))
    if costs is None or limit is None:
        return None
    return emcc.share(sum(cost <= limit for cost in costs), len(costs))
