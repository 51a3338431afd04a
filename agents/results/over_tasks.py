"""Measures over several tasks: the values of the seeds that all have, and two sets of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import emcc
from agents.results.measures import Measure, measures
from agents.results.reading import Group
from emcc import Interval

Matrices = Mapping[str, NDArray[np.float64]]
"""Values [seeds, tasks] by the measure's name."""


def common_measures() -> list[Measure]:
    """Those with a scale that tasks share, and a better direction: of training, not of the trained
    policy, whose returns and costs have no common scale."""
    return [m for m in measures() if m.of == "training" and m.better != "neither"]


def matrices(groups: Sequence[Group], fewest: int) -> Matrices:
    """Values of the seeds that the groups, one of each task, have in common; those known alone.

    Empty where these are fewer than `fewest`.
    """
    seeds = sorted(set.intersection(*(set(group.seeds) for group in groups)))
    if len(seeds) < fewest:
        return {}
    runs = [{run.seed: run for run in group.runs} for group in groups]
    found = {}
    for measure in common_measures():
        values = [[of_task[seed].measures.get(measure.name) for of_task in runs] for seed in seeds]
        if not any(value is None for row in values for value in row):
            found[measure.name] = np.array(values, dtype=np.float64)
    return found


def seeds_of(values: Matrices) -> int:
    """Number of seeds."""
    return len(next(iter(values.values())))


def bootstrapped(
    statistic: Callable[..., float], *sets: NDArray[np.float64] | None
) -> Interval | None:
    """A statistic of values [seeds, tasks] with its stratified interval; None where some lack."""
    known = [values for values in sets if values is not None]
    if len(known) < len(sets):
        return None
    return emcc.bootstrap(statistic, *known, rng=np.random.default_rng(0), resamples=1_000)


@dataclass(frozen=True)
class TwoSets:
    """Values of two sets of runs on the same tasks. What a side does not know is None."""

    a: Matrices
    b: Matrices
    tasks: int

    @property
    def size(self) -> str:
        """Tasks, and seeds of either side, in words."""
        return f"{self.tasks} tasks, {seeds_of(self.b)} seeds against {seeds_of(self.a)}"

    def difference(self, measure: Measure) -> Interval | None:
        """B - A of the means over seeds and tasks, with its bootstrap interval."""
        return bootstrapped(lambda a, b: float(b.mean() - a.mean()), *self._values(measure))

    def p(self, measure: Measure) -> float | None:
        """P value of the permutation test of these means, not corrected."""
        a, b = self._values(measure)
        if a is None or b is None:
            return None
        return emcc.permutation_test(a, b, rng=np.random.default_rng(0))

    def improvement(self, measure: Measure) -> Interval | None:
        """Probability that a run of B is better than one of A on a task, mean over the tasks."""
        sides = self._values(measure)
        if measure.better == "higher":
            sides = sides[::-1]  # `emcc` has the probability that the second is lower
        return bootstrapped(emcc.probability_of_improvement, *sides)

    def _values(self, measure: Measure) -> tuple[NDArray[np.float64] | None, ...]:
        return self.a.get(measure.name), self.b.get(measure.name)


def two_sets(pairs: Sequence[tuple[Group, Group]]) -> TwoSets | None:
    """The values of groups A and B, a pair for each task; None of fewer than two tasks, or where a
    side has fewer than two seeds that all tasks have."""
    if len(pairs) < 2:
        return None
    a, b = (matrices(groups, 2) for groups in zip(*pairs, strict=True))
    return TwoSets(a, b, len(pairs)) if a and b else None
