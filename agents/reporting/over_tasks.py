"""Tables over all tasks: interquartile means, probabilities of improvement, and differences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any

from agents.paper.settings import changes, in_order, title_of
from agents.reporting.table import Row, Table, number_of, p_number
from agents.results.over_tasks import TwoSets, bootstrapped, common_measures, matrices, seeds_of
from agents.results.reading import Group
from agents.results.statistics import corrected
from emcc import iqm
from emcc.statistics import FEWEST_RUNS

TEST = (
    "permutation test of Welch's t of the means over seeds and tasks, with runs exchanged within "
    "each task alone, corrected for"
)
"""Of both tables, before the number of comparisons."""


def over_tasks(groups: Sequence[Group]) -> Table | None:
    """Measures of training over all tasks, of the algorithms that have presets' runs of one length
    on each.

    None where there are not two tasks with five seeds each.
    """
    columns = common_measures()
    tasks = list(dict.fromkeys(group.config.task for group in groups if group.runs))
    by_name: dict[str, dict[str, Group]] = {}
    for group in in_order(groups):
        if group.runs and not changes(group.config):
            of_name = by_name.setdefault(title_of(group.config), {})
            same = of_name.setdefault(group.config.task, group)
            of_name[group.config.task] = max(same, group, key=lambda of: len(of.runs))
    common = {name: of for name, of in by_name.items() if len(of) == len(tasks)}
    runs = {name: matrices(list(of.values()), FEWEST_RUNS) for name, of in common.items()}
    runs = {name: of for name, of in runs.items() if of}
    if len(tasks) < 2 or not runs:
        return None
    rows = []
    for name, of in runs.items():
        cells = [number_of(bootstrapped(iqm, of.get(m.name)), m.digits) for m in columns]
        rows.append(Row(f"{name}, {seeds_of(of)} seeds", cells, kind="mean"))
    pairs = {(a, b): TwoSets(runs[b], runs[a], len(tasks)) for a, b in combinations(runs, 2)}
    p_values = corrected({(pair, m.name): of.p(m) for pair, of in pairs.items() for m in columns})
    for (a, b), sets in pairs.items():
        better = [number_of(sets.improvement(m)) for m in columns]
        tests = [p_number(p_values[(a, b), m.name]) for m in columns]
        rows.append(Row(f"P({a} better than {b})", better, kind="test"))
        rows.append(Row("p", tests, kind="test"))
    caption = (
        f"Over {len(tasks)} tasks, with the presets: interquartile mean of all seeds and tasks; P: "
        "probability that a run of the first is better than one of the second on a task, equal "
        "ones half, mean over the tasks; [95 % bootstrap interval, seeds drawn in each task anew]; "
        f"p: {TEST} the {_count(p_values)} comparisons of this table (Holm). "
        f"Algorithms with {FEWEST_RUNS} seeds or more on every task, the seeds that all tasks "
        "have; of several folders of equal settings on a task, the one of most runs"
    )
    return Table(caption, [f"{len(tasks)} tasks", *(m.head for m in columns)], rows)


def differences_over_tasks(sets: Mapping[str, TwoSets]) -> Table | None:
    """Differences B - A of the means over all tasks, with a test of each; None of no sets.

    sets: by the name of their rows.
    """
    if not sets:
        return None
    columns = common_measures()
    p_values = corrected({(name, m.name): of.p(m) for name, of in sets.items() for m in columns})
    rows = []
    for name, of in sets.items():
        # A digit more than means have: over tasks small differences can be told from none.
        differences = [number_of(of.difference(m), m.digits + 1, signed=True) for m in columns]
        better = [number_of(of.improvement(m)) for m in columns]
        rows += [
            Row(f"{name}, {of.size}", differences, kind="difference"),
            Row("p", [p_number(p_values[name, m.name]) for m in columns], kind="test"),
            Row("P(B better)", better, kind="test"),
        ]
    caption = (
        "Over all tasks that both have: B - A, difference of the means over seeds and tasks [95 % "
        "bootstrap interval, seeds drawn in each task anew, where both have "
        f"{FEWEST_RUNS} or more]; p: {TEST} the {_count(p_values)} comparisons of this table "
        "(Holm); P(B better): probability that a run of B is better than one of A on a task, equal "
        "ones half, mean over the tasks. The seeds that all tasks have"
    )
    return Table(caption, ["over all tasks", *(m.head for m in columns)], rows)


def _count(p_values: Mapping[Any, float | None]) -> int:
    """How many are known."""
    return sum(p is not None for p in p_values.values())
