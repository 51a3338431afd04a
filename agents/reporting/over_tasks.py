"""The table over all tasks: interquartile means, and probabilities of improvement."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from agents.algorithms import title
from agents.paper.settings import changes, in_order
from agents.reporting.table import Number, Row, Table, number_of
from agents.results.measures import Measure, measures
from agents.results.reading import Group
from emcc import Interval, bootstrap, iqm, probability_of_improvement
from emcc.statistics import FEWEST_RUNS


def over_tasks(groups: Sequence[Group]) -> Table | None:
    """Measures of training over all tasks, of the algorithms that have presets' runs on each.

    None where there are not two tasks with five seeds each. Measures of the trained policy are left
    out: returns and costs of different tasks have no common scale.
    """
    columns = [m for m in measures() if m.of == "training" and m.better != "neither"]
    tasks = list(dict.fromkeys(group.config.task for group in groups if group.runs))
    by_name: dict[str, dict[str, Group]] = {}
    for group in in_order(groups):
        if group.runs and not changes(group.config):
            by_name.setdefault(group.config.algorithm, {}).setdefault(group.config.task, group)
    common = {name: of for name, of in by_name.items() if len(of) == len(tasks)}
    runs = {name: _matrices(list(of.values()), columns) for name, of in common.items()}
    runs = {name: of for name, of in runs.items() if of}
    if len(tasks) < 2 or not runs:
        return None
    rows = [
        Row(f"{title(name)}, {_seeds(of)} seeds", [_iqm(of, m) for m in columns], kind="mean")
        for name, of in runs.items()
    ]
    for a, b in combinations(runs, 2):
        cells = [_improvement(runs[a], runs[b], m) for m in columns]
        rows.append(Row(f"P({title(a)} better than {title(b)})", cells, kind="test"))
    caption = (
        f"Over {len(tasks)} tasks, with the presets: interquartile mean of all seeds and tasks; P: "
        "probability that a run of the first is better than one of the second on a task, equal "
        "ones half, mean over the tasks; [95 % bootstrap interval, seeds drawn in each task anew]. "
        f"Algorithms with {FEWEST_RUNS} seeds or more on every task, the seeds that all tasks have"
    )
    return Table(caption, [f"{len(tasks)} tasks", *(m.head for m in columns)], rows)


Matrices = Mapping[str, NDArray[np.float64]]


def _matrices(groups: Sequence[Group], columns: Sequence[Measure]) -> Matrices:
    """Values [seeds, tasks] of the seeds that all groups have, by measure; those known alone.

    Empty where there are too few seeds.
    """
    seeds = sorted(set.intersection(*(set(group.seeds) for group in groups)))
    if len(seeds) < FEWEST_RUNS:
        return {}
    runs = [{run.seed: run for run in group.runs} for group in groups]
    found = {}
    for measure in columns:
        values = [[of_task[seed].measures.get(measure.name) for of_task in runs] for seed in seeds]
        if not any(value is None for row in values for value in row):
            found[measure.name] = np.array(values, dtype=np.float64)
    return found


def _seeds(of: Matrices) -> int:
    return len(next(iter(of.values())))


def _iqm(of: Matrices, measure: Measure) -> Number:
    values = of.get(measure.name)
    return number_of(values if values is None else _bootstrap(iqm, values), measure.digits)


def _improvement(of_a: Matrices, of_b: Matrices, measure: Measure) -> Number:
    a, b = of_a.get(measure.name), of_b.get(measure.name)
    if a is None or b is None:
        return Number(None)
    sides = (b, a) if measure.better == "lower" else (a, b)  # the share of the second that is lower
    return number_of(_bootstrap(probability_of_improvement, *sides))


def _bootstrap(statistic: Callable[..., float], *sets: NDArray[np.float64]) -> Interval:
    return bootstrap(statistic, *sets, rng=np.random.default_rng(0), resamples=1_000)
