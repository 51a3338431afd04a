"""Statistics of runs, computed with `emcc`.

A measure has no mean over runs if one of them lacks it. Each statistic has its own random
generator, so that it does not depend on which others are computed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Hashable, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

import emcc
from agents.results.groups import Group, RunResult
from agents.results.measures import Measure, measure, measures
from emcc import Interval, Share
from emcc.parts import PARTS
from emcc.statistics import FEWEST_RUNS, UNBOUNDED, Bounds

if TYPE_CHECKING:
    import pandas

Key = TypeVar("Key", bound=Hashable)
Values = Sequence[float | None]
Pair = tuple[Group, Group]

LEVEL = 0.05
"""Significance level of all tests: a p value up to it shows a difference."""
MARGIN = 0.02
"""Margin of the equivalence test, in cost per step: cost rates are printed to two decimals, and a
difference of up to two units in the last one counts as none."""
INTERVALS = (
    f"[95 % t interval over seeds], or the range of fewer than {FEWEST_RUNS} seeds and of seeds "
    "that end in different places"
)
"""The intervals of means in words. They are cut at the bounds of the values: a cost's at 0."""


def known(values: Values) -> list[float] | None:
    """Return the values, or None if there are none or one is unknown (None or NaN)."""
    numbers = [value for value in values if value is not None and not math.isnan(value)]
    return numbers if numbers and len(numbers) == len(values) else None


def mean_of(values: Values, one_place: bool = True, bounds: Bounds = UNBOUNDED) -> Interval | None:
    """Return the mean over runs with its 95 % t interval, or with the range of few values.

    one_place: whether all runs end in the same place. If not, or with fewer than five runs, the
    interval is the range of the values. bounds: see `emcc.mean_interval`.
    """
    numbers = known(values)
    if numbers is None:
        return None
    mean = emcc.mean_interval(numbers, bounds=bounds)
    if one_place or mean.kind == "range":
        return mean
    return replace(mean, low=min(numbers), high=max(numbers), kind="range")


def difference_of(a: Values, b: Values, one_place: bool = True) -> Interval | None:
    """Return the mean of `b` minus the mean of `a`, with Welch's 95 % t interval.

    one_place: whether all runs of each side end in one place. If not, or if a side has fewer than
    five runs, both ends of the interval are None.
    """
    first, second = known(a), known(b)
    if first is None or second is None:
        return None
    gap = emcc.mean_difference(first, second)
    return gap if one_place else replace(gap, low=None, high=None, kind="range")


def p_of(a: Values, b: Values) -> float | None:
    """Return the p value of the permutation test; None if a side has fewer than two runs."""
    sides = _two_sides(a, b)
    return sides and emcc.permutation_test(*sides, rng=np.random.default_rng(0))


def equivalence_of(a: Values, b: Values, margin: float) -> float | None:
    """Return the p value of the equivalence test; None if a side has fewer than two runs."""
    sides = _two_sides(a, b)
    return sides and emcc.equivalence_test(*sides, margin, rng=np.random.default_rng(0))


def _two_sides(a: Values, b: Values) -> tuple[list[float], list[float]] | None:
    first, second = known(a), known(b)
    if first is None or second is None or min(len(first), len(second)) < 2:
        return None
    return first, second


def group_mean(group: Group, name: str) -> Interval | None:
    """Return the mean of a measure over a group's runs: see `mean_of`."""
    return mean_of(group.values(name), group.one_place, measure(name).bounds)


def places(group: Group) -> dict[str, Share]:
    """Return the share of a group's runs that end in each place by each way there, the most
    frequent first; empty for a task without named places."""
    ends = [run.place for run in group.runs if run.place]
    counted = sorted(dict.fromkeys(ends), key=lambda place: -ends.count(place))
    return {place: emcc.share(ends.count(place), len(group.runs)) for place in counted}


def common_limit(groups: Collection[Group]) -> float | None:
    """Return the cost limit that all groups share; None if their costs or limits differ."""
    limits, costs = {group.limit for group in groups} - {None}, {group.cost for group in groups}
    return limits.pop() if len(limits) == len(costs) == 1 else None


def within_limit(group: Group) -> Share | None:
    """Return the share of a group's runs whose J_C satisfies the limit; None if unknown."""
    costs, limit = known(group.values("J_C")), group.limit
    if costs is None or limit is None:
        return None
    return emcc.share(sum(cost <= limit for cost in costs), len(costs))


class Difference(NamedTuple):
    """Comparison of two groups A and B by one measure; unknown values are None."""

    gap: Interval | None
    """B - A: see `difference_of`."""
    p: float | None
    """P value of the permutation test, not corrected."""
    better: Interval | None
    """Probability that a run of B is better than a run of A, with its bootstrap interval; None for
    a measure without a better direction."""


def differences(a: Group, b: Group) -> dict[str, Difference]:
    """Compare two groups by each measure, by name."""
    told = {}
    for m in measures():
        sides = a.values(m.name), b.values(m.name)
        gap = difference_of(*sides, a.one_place and b.one_place)
        told[m.name] = Difference(gap, p_of(*sides), _better(m, *map(known, sides)))
    return told


def _better(m: Measure, a: list[float] | None, b: list[float] | None) -> Interval | None:
    if a is None or b is None or m.better == "neither":
        return None
    # `emcc` gives the probability that the second is lower.
    sides = (a, b) if m.better == "lower" else (b, a)
    rng = np.random.default_rng(0)
    return emcc.bootstrap(emcc.probability_of_improvement, *sides, rng=rng)


def only(asked: Collection[str] | None, told: Mapping[str, Difference]) -> Mapping[str, Difference]:
    """Return the differences, keeping p values only for the measures in `asked`; None: for all."""
    if asked is None:
        return told
    return {m: d if m in asked else d._replace(p=None) for m, d in told.items()}


def holm(
    tested: Mapping[Key, Mapping[str, Difference]],
) -> tuple[dict[Key, dict[str, Difference]], int]:
    """Correct the p values of all pairs and measures together by Holm's method.

    Returns the differences and the number of p values; unknown p values stay None."""
    known = [(k, m, d.p) for k, told in tested.items() for m, d in told.items() if d.p is not None]
    adjusted = emcc.holm([p for *_, p in known]) if known else ()
    p_values = {(k, m): float(p) for (k, m, _), p in zip(known, adjusted, strict=True)}
    corrected = {
        k: {m: d._replace(p=p_values.get((k, m))) for m, d in told.items()}
        for k, told in tested.items()
    }
    return corrected, len(known)


def by_third(group: Group, stem: str) -> dict[float, list[float]]:
    """Return a measure's value in each run, by third of training, for thirds that all runs have.

    stem: "EMCC", or "rate" for the cost rate of a third.
    """
    values = {part: known(group.values(f"{stem}_{part}")) for part in PARTS}
    return {part: of_runs for part, of_runs in values.items() if of_runs is not None}


ACROSS = 10
"""Episodes per window over which EMCC is taken to compare on- and off-policy algorithms. A rollout
has ten episodes for the paper's on-policy methods and one for the off-policy ones, and MCC, a
maximum over the rollout, rises with the rollout's size."""
ACROSS_WORDS = (
    f"EMCC is taken over windows of {ACROSS} episodes here, since the rollouts of on- and "
    "off-policy algorithms differ in size."
)


def over_windows(group: Group, window: int = ACROSS) -> Group:
    """Return the group with measures of thirds over windows; runs that have windows keep them."""
    return replace(group, runs=[_over_windows(run, window) for run in group.runs])


def _over_windows(run: RunResult, window: int) -> RunResult:
    if run.window is not None:
        return run
    run = replace(run, window=window)
    of_thirds = {m.name: m.compute(run) for m in measures(shown=False) if m.part is not None}
    return replace(run, measures={**run.measures, **of_thirds})


def mixed(groups: Iterable[Group]) -> bool:
    """Whether groups with EMCC over rollouts include both on- and off-policy algorithms."""
    there = [group for group in groups if any(run.window is None for run in group.runs)]
    return len({group.off_policy for group in there}) > 1


def alike(groups: Sequence[Group]) -> list[Group]:
    """Return the groups with comparable EMCC: over windows where `mixed`."""
    return [over_windows(group) for group in groups] if mixed(groups) else list(groups)


def comparisons(groups: Sequence[Group]) -> pandas.DataFrame:
    """Return a row for each pair of groups with the same task and cost and each third of training.

    Groups of fewer than five runs are left out. Columns: a, b: the groups. part: the third, as in
    `emcc.parts.PARTS`. rate_p: p value of the permutation test of the cost rates; equivalence_p: of
    their equivalence test with `MARGIN`; equal_rates: whether the rates are equivalent and do not
    differ significantly. emcc_p: p value of the permutation test of EMCC, Holm-corrected over rows.
    """
    import pandas as pd

    enough = [group for group in groups if len(group.runs) >= FEWEST_RUNS]
    found = {id(g): (by_third(g, "rate"), by_third(g, "EMCC")) for g in enough}
    rows = []
    for a, b in combinations(enough, 2):
        if (a.task, a.cost) != (b.task, b.cost):
            continue
        (rates_a, emccs_a), (rates_b, emccs_b) = found[id(a)], found[id(b)]
        for part in [p for p in rates_a if p in rates_b]:
            rates, emccs = (rates_a[part], rates_b[part]), (emccs_a[part], emccs_b[part])
            rows.append((a, b, part, p_of(*rates), equivalence_of(*rates, MARGIN), p_of(*emccs)))
    told = pd.DataFrame(rows, columns=["a", "b", "part", "rate_p", "equivalence_p", "emcc_p"])
    told["equal_rates"] = (told.rate_p > LEVEL) & (told.equivalence_p <= LEVEL)
    return told.assign(emcc_p=emcc.holm(told.emcc_p)) if rows else told


def common_measures() -> list[Measure]:
    """Return the measures that can be averaged over tasks: those of training with a better
    direction. The trained policy's returns and costs have no common scale."""
    return [m for m in measures() if m.of == "training" and m.better != "neither"]


def on_common_seeds(groups: Sequence[Group], fewest: int) -> dict[str, NDArray[np.float64]]:
    """Return the `common_measures` by name, each [seeds, tasks], on the seeds that all groups have.

    groups: one for each task. Leaves out measures with an unknown value; empty if the groups share
    fewer than `fewest` seeds.
    """
    seeds = sorted(set.intersection(*(set(group.seeds) for group in groups)))
    if len(seeds) < fewest:
        return {}
    runs = [{run.seed: run.measures for run in group.runs} for group in groups]
    values = {
        m.name: np.array([[own[seed].get(m.name) for own in runs] for seed in seeds], float)
        for m in common_measures()
    }
    return {name: table for name, table in values.items() if not np.isnan(table).any()}


def bootstrapped(statistic: Callable[..., float], *sets: NDArray[np.float64]) -> Interval:
    """Return a statistic of values [seeds, tasks] with its stratified bootstrap interval."""
    return emcc.bootstrap(statistic, *sets, rng=np.random.default_rng(0), resamples=1_000)


def differences_of_sets(
    a: Mapping[str, NDArray], b: Mapping[str, NDArray], gaps: bool = True
) -> dict[str, Difference]:
    """Compare the means over seeds and tasks, B - A, by each of the `common_measures`.

    a, b: see `on_common_seeds`. gaps: whether to compute the differences besides the tests.
    """
    told = {}
    for m in common_measures():
        if m.name not in a or m.name not in b:
            told[m.name] = Difference(None, None, None)
            continue
        sides = a[m.name], b[m.name]
        gap = bootstrapped(lambda a, b: float(b.mean() - a.mean()), *sides) if gaps else None
        p = emcc.permutation_test(*sides, rng=np.random.default_rng(0))
        better = sides[::-1] if m.better == "higher" else sides
        told[m.name] = Difference(gap, p, bootstrapped(emcc.probability_of_improvement, *better))
    return told


OverTasks = Mapping[tuple[str, str, str], Mapping[str, Difference]]
"""Differences B - A over tasks; key: the pair's name, "4 tasks" and "10 seeds against 10"."""


def pairs_over_tasks(named: Iterable[tuple[str, Pair]]) -> OverTasks:
    """Compare groups A and B over tasks, for each name of a pair.

    named: names with pairs, one pair for each task. Only names with at least two tasks, and at
    least two seeds that all tasks share, are compared."""
    by_name: dict[str, list[Pair]] = {}
    for name, pair in named:
        by_name.setdefault(name, []).append(pair)
    told = {}
    for name, pairs in by_name.items():
        a, b = (on_common_seeds(groups, 2) for groups in zip(*pairs, strict=True))
        if len(pairs) > 1 and a and b:
            seeds = [len(next(iter(side.values()))) for side in (b, a)]
            key = name, f"{len(pairs)} tasks", f"{seeds[0]} seeds against {seeds[1]}"
            told[key] = differences_of_sets(a, b)
    return told
