"""Statistics of runs, which call `emcc`.

A measure that one of the runs lacks has no mean over them. Each number has a random generator of
its own: none depends on which others are asked for.
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
"""Level of every test: p values up to it tell a difference."""
MARGIN = 0.02
"""Cost per step. Cost rates are printed to two digits; two of the last ones are taken as equal."""
INTERVALS = (
    f"[95 % t interval over seeds], or the range of fewer than {FEWEST_RUNS} seeds and of seeds "
    "that end in different places"
)
"""The intervals of means in words. They end where no value can be beyond: a cost at 0."""


def known(values: Values) -> list[float] | None:
    """The values, or None where there are none or one is unknown (None or NaN)."""
    numbers = [value for value in values if value is not None and not math.isnan(value)]
    return numbers if numbers and len(numbers) == len(values) else None


def mean_of(values: Values, one_place: bool = True, bounds: Bounds = UNBOUNDED) -> Interval | None:
    """Mean over runs with its 95 % t interval; with its range where there are fewer than five.

    one_place: whether all end in the same place; the mean of others has its range too. bounds: see
    `emcc.mean_interval`.
    """
    numbers = known(values)
    if numbers is None:
        return None
    mean = emcc.mean_interval(numbers, bounds=bounds)
    if one_place or mean.kind == "range":
        return mean
    return replace(mean, low=min(numbers), high=max(numbers), kind="range")


def difference_of(a: Values, b: Values, one_place: bool = True) -> Interval | None:
    """Mean over the runs of `b` less that over `a`, with Welch's 95 % t interval.

    None for its ends where a side has fewer than five runs, or not one_place: not all runs of
    either side end in one place.
    """
    first, second = known(a), known(b)
    if first is None or second is None:
        return None
    gap = emcc.mean_difference(first, second)
    return gap if one_place else replace(gap, low=None, high=None, kind="range")


def p_of(a: Values, b: Values) -> float | None:
    """P value of the permutation test; None where a side has fewer than two runs."""
    sides = _two_sides(a, b)
    return sides and emcc.permutation_test(*sides, rng=np.random.default_rng(0))


def equivalence_of(a: Values, b: Values, margin: float) -> float | None:
    """P value of the equivalence test; None where a side has fewer than two runs."""
    sides = _two_sides(a, b)
    return sides and emcc.equivalence_test(*sides, margin, rng=np.random.default_rng(0))


def _two_sides(a: Values, b: Values) -> tuple[list[float], list[float]] | None:
    first, second = known(a), known(b)
    if first is None or second is None or min(len(first), len(second)) < 2:
        return None
    return first, second


def group_mean(group: Group, name: str) -> Interval | None:
    """Mean of a measure over a group's runs: see `mean_of`."""
    return mean_of(group.values(name), group.one_place, measure(name).bounds)


def places(group: Group) -> dict[str, Share]:
    """Share of a group's runs that end in each place, by each way there, the most frequent first;
    empty without."""
    ends = [run.place for run in group.runs if run.place]
    counted = sorted(dict.fromkeys(ends), key=lambda place: -ends.count(place))
    return {place: emcc.share(ends.count(place), len(group.runs)) for place in counted}


def common_limit(groups: Collection[Group]) -> float | None:
    """The one cost limit that groups share; None if they limit other costs, or at other values."""
    limits, costs = {group.limit for group in groups} - {None}, {group.cost for group in groups}
    return limits.pop() if len(limits) == len(costs) == 1 else None


def within_limit(group: Group) -> Share | None:
    """Share of a group's runs whose J_C is within its limit; None where that is not known."""
    costs, limit = known(group.values("J_C")), group.limit
    if costs is None or limit is None:
        return None
    return emcc.share(sum(cost <= limit for cost in costs), len(costs))


class Difference(NamedTuple):
    """A measure of two groups A and B; None for what is not known."""

    gap: Interval | None
    """B - A: see `difference_of`."""
    p: float | None
    """Permutation test, not corrected."""
    better: Interval | None
    """Probability that a run of B is better than one of A, with its bootstrap interval; None for a
    measure of which neither direction is better."""


def differences(a: Group, b: Group) -> dict[str, Difference]:
    """The measures of two groups by name."""
    told = {}
    for m in measures():
        sides = a.values(m.name), b.values(m.name)
        gap = difference_of(*sides, a.one_place and b.one_place)
        told[m.name] = Difference(gap, p_of(*sides), _better(m, *map(known, sides)))
    return told


def _better(m: Measure, a: list[float] | None, b: list[float] | None) -> Interval | None:
    if a is None or b is None or m.better == "neither":
        return None
    # `emcc` has the probability that the second is lower.
    sides = (a, b) if m.better == "lower" else (b, a)
    rng = np.random.default_rng(0)
    return emcc.bootstrap(emcc.probability_of_improvement, *sides, rng=rng)


def only(asked: Collection[str] | None, told: Mapping[str, Difference]) -> Mapping[str, Difference]:
    """The differences with p values of the measures alone that are asked about; None: of all."""
    if asked is None:
        return told
    return {m: d if m in asked else d._replace(p=None) for m, d in told.items()}


def holm(
    tested: Mapping[Key, Mapping[str, Difference]],
) -> tuple[dict[Key, dict[str, Difference]], int]:
    """The differences of all pairs with their p values corrected for their number by Holm's method,
    and that number. Those not known stay so."""
    known = [(k, m, d.p) for k, told in tested.items() for m, d in told.items() if d.p is not None]
    adjusted = emcc.holm([p for *_, p in known]) if known else ()
    p_values = {(k, m): float(p) for (k, m, _), p in zip(known, adjusted, strict=True)}
    corrected = {
        k: {m: d._replace(p=p_values.get((k, m))) for m, d in told.items()}
        for k, told in tested.items()
    }
    return corrected, len(known)


def by_third(group: Group, stem: str) -> dict[float, list[float]]:
    """A measure of each run, by the thirds of training that all runs have.

    stem: "EMCC" or "rate", the cost rate of a third.
    """
    values = {part: known(group.values(f"{stem}_{part}")) for part in PARTS}
    return {part: of_runs for part, of_runs in values.items() if of_runs is not None}


ACROSS = 10
"""Episodes of the windows over which EMCC is taken where on- and off-policy algorithms are
compared. A rollout is ten episodes of the paper's on-policy methods, one of the others, and MCC, a
maximum over it, rises with its size."""
ACROSS_WORDS = (
    f"EMCC is taken over windows of {ACROSS} episodes here, since the rollouts of on- and "
    "off-policy algorithms differ in size."
)


def over_windows(group: Group, window: int = ACROSS) -> Group:
    """The group with measures of thirds over windows, which runs that have some already keep."""
    return replace(group, runs=[_over_windows(run, window) for run in group.runs])


def _over_windows(run: RunResult, window: int) -> RunResult:
    if run.window is not None:
        return run
    run = replace(run, window=window)
    of_thirds = {m.name: m.compute(run) for m in measures(shown=False) if m.part is not None}
    return replace(run, measures={**run.measures, **of_thirds})


def mixed(groups: Iterable[Group]) -> bool:
    """Whether on- and off-policy algorithms are among the groups, and EMCC is by rollouts."""
    there = [group for group in groups if any(run.window is None for run in group.runs)]
    return len({group.off_policy for group in there}) > 1


def alike(groups: Sequence[Group]) -> list[Group]:
    """The groups with EMCC that can be compared: over windows where families are mixed."""
    return [over_windows(group) for group in groups] if mixed(groups) else list(groups)


def comparisons(groups: Sequence[Group]) -> pandas.DataFrame:
    """A row for each pair of groups on a task, of one cost, in each third of training. Groups of
    fewer than five runs are in none.

    a, b: the groups. part: the third, as in `emcc.parts.PARTS`. rate_p: permutation test of the
    cost rates; equivalence_p: their equivalence test with `MARGIN`; equal_rates: they are
    equivalent, and not told apart. emcc_p: permutation test of EMCC, corrected for all rows (Holm).
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
    """Measures with a scale that tasks share, and a better direction: of training, not of the
    trained policy, whose returns and costs have no common scale."""
    return [m for m in measures() if m.of == "training" and m.better != "neither"]


def on_common_seeds(groups: Sequence[Group], fewest: int) -> dict[str, NDArray[np.float64]]:
    """Measures that tasks share, [seeds, tasks], of the seeds that the groups, one of each task,
    have in common; those known alone.

    Empty where these seeds are fewer than `fewest`.
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
    """A statistic of values [seeds, tasks] with its stratified interval."""
    return emcc.bootstrap(statistic, *sets, rng=np.random.default_rng(0), resamples=1_000)


def differences_of_sets(
    a: Mapping[str, NDArray], b: Mapping[str, NDArray], gaps: bool = True
) -> dict[str, Difference]:
    """B - A of the means over seeds and tasks, by the measures that tasks share.

    a, b: see `on_common_seeds`. gaps: whether the differences themselves are asked for, besides the
    test.
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
"""Differences B - A over tasks by the pair's name, "4 tasks" and "10 seeds against 10"."""


def pairs_over_tasks(named: Iterable[tuple[str, Pair]]) -> OverTasks:
    """The differences of groups A and B, a pair for each task, by their name; of those that are
    there on two tasks or more, with two seeds or more that all tasks have."""
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
