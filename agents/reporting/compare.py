"""Two sets of runs side by side, with the differences of their means."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from agents.errors import UserError
from agents.paper.settings import changes, in_order, name_of, with_distinct_titles
from agents.reporting.csv_table import (
    Line,
    difference_lines,
    group_lines,
    numbers_csv,
    two_sets_lines,
)
from agents.reporting.figures import curves
from agents.reporting.over_tasks import differences_over_tasks
from agents.reporting.page import Section, page
from agents.reporting.provenance import made, name_of_all
from agents.reporting.table import Number, Row, Table, markdown, number_of, p_number
from agents.reporting.tables import caption, mean_row, measures_table, run_rows
from agents.reporting.together import TASKS
from agents.results.measures import measures
from agents.results.over_tasks import TwoSets, two_sets
from agents.results.reading import Group, read
from agents.results.statistics import LEVEL, corrected, group_difference, improvement_of, p_of
from agents.training.files import write_whole

METHOD = (
    "B - A: difference of the means [Welch's 95 % t interval, where both sides have five seeds or "
    "more that end in one place]; p: two-sided permutation test of Welch's t, corrected for the "
    "{} comparisons made here (Holm); P(B better): probability that a run of B is better than one "
    "of A, equal ones half [95 % bootstrap interval]"
)
Pair = tuple[Group, Group]
PValues = Mapping[tuple[str, str, str], float | None]


class Sides(NamedTuple):
    """The complete runs of two folders on one task."""

    a: list[Group]
    b: list[Group]

    @property
    def named(self) -> list[tuple[str, Group]]:
        """Every group with its name."""
        of_sides = zip(("A", "B"), self, strict=True)
        return [(f"{k}: {name_of(g)}", g) for k, groups in of_sides for g in groups]


def compare(a: Path, b: Path, out: Path | None = None) -> list[Table]:
    """The tables of two folders of runs with the differences B - A, task by task, and over tasks.

    a, b: folders, archives, or folders of archives, as `report` takes them. A group of B stands
    against the one of A with the same algorithm and settings, or where there is none against every
    group of A on the task. The last table has one test over all tasks of each pair that is there on
    two tasks or more. With out, writes `compare.md`, `compare.csv`, and `compare.html` with
    training curves, both sides in one figure. Raises UserError where a side has no complete run, or
    the two have no task in common.
    """
    notes: list[str] = []
    sides = [with_distinct_titles(read([side], notes)) for side in (a, b)]
    found = [[g for g in side if g.runs] for side in sides]
    tasks = [list(dict.fromkeys(group.config.task for group in groups)) for groups in found]
    common = [task for task in tasks[0] if task in tasks[1]]
    if not common:
        raise UserError(
            f"{a} and {b} have no task in common: {', '.join(tasks[0])} against "
            f"{', '.join(tasks[1])}"
        )
    for name, of_side in zip("AB", tasks, strict=True):
        alone = [task for task in of_side if task not in common]
        notes += [f"only {name} has runs on {', '.join(alone)}."] if alone else []
    by_task = {
        task: Sides(*([g for g in groups if g.config.task == task] for groups in found))
        for task in common
    }
    notes.insert(0, f"A is {a}, B is {b}.")
    p_values, sets = _p_values(by_task.values()), _over_tasks(by_task.values())
    tables = {
        task: _table(task, sides, p_values, notes if task == common[-1] else [])
        for task, sides in by_task.items()
    }
    if (together := differences_over_tasks(sets)) is not None:
        tables[TASKS] = together
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        drawn = {task: [curves(sides.named)] for task, sides in by_task.items()}
        sections = [Section(of, table, drawn.get(of, [])) for of, table in tables.items()]
        how = {
            f"{name}, {k}": text
            for name, side in zip("AB", sides, strict=True)
            for k, text in made(side).items()
        }
        title = f"{name_of_all(sides[0])} (A) and {name_of_all(sides[1])} (B)"
        write_whole(out / "compare.html", page(title, sections, how))
        write_whole(out / "compare.md", markdown(list(tables.values())))
        lines = [line for sides in by_task.values() for line in _lines(sides)]
        lines += [line for name, of in sets.items() for line in two_sets_lines(of, name)]
        write_whole(out / "compare.csv", numbers_csv(lines))
    return list(tables.values())


def _table(task: str, sides: Sides, p_values: PValues, notes: Sequence[str]) -> Table:
    """Means of both sides, the differences, then every run."""
    named = list(zip(("A: ", "B: "), sides, strict=True))
    rows = [mean_row(group, prefix) for prefix, groups in named for group in groups]
    rows += [row for pair in _pairs(sides) for row in _difference_rows(*pair, p_values)]
    for prefix, groups in named:
        rows += [row for group in in_order(groups) for row in run_rows(group, prefix)]
    count = sum(p is not None for p in p_values.values())
    notes = [*notes, *_notes(task, sides, count)]
    words = f"{caption([*sides.a, *sides.b])}; {METHOD.format(count)}"
    return measures_table(words, task, rows, notes)


def _pairs(sides: Sides) -> list[Pair]:
    pairs = []
    for of_b in sides.b:
        same = [of_a for of_a in sides.a if _settings(of_a) == _settings(of_b)]
        pairs += [(of_a, of_b) for of_a in same or sides.a]
    return pairs


def _settings(group: Group) -> tuple[str, dict[str, Any]]:
    return group.config.algorithm, changes(group.config)


def _over_tasks(of_tasks: Iterable[Sides]) -> dict[str, TwoSets]:
    """Pairs that stand against each other on two tasks or more, by their name."""
    by_name: dict[str, list[Pair]] = {}
    for a, b in (pair for sides in of_tasks for pair in _pairs(sides)):
        by_name.setdefault(_difference_name(a, b), []).append((a, b))
    found = {name: two_sets(pairs) for name, pairs in by_name.items()}
    return {name: sets for name, sets in found.items() if sets}


def _p_values(of_tasks: Iterable[Sides]) -> PValues:
    """Corrected p values of every pair, by the folders of its runs and the measure."""
    pairs = [pair for sides in of_tasks for pair in _pairs(sides)]
    return corrected(
        {
            (a.folder, b.folder, m.name): p_of(a.values(m.name), b.values(m.name))
            for a, b in pairs
            for m in measures()
        }
    )


def _difference_rows(a: Group, b: Group, p_values: PValues) -> Iterator[Row]:
    name, empty = _difference_name(a, b), Number(None)
    gaps = [(group_difference(a, b, m.name), m.digits) for m in measures()]
    cells = [number_of(*of_measure, signed=True) for of_measure in gaps]
    yield Row(name, [*cells, empty], kind="difference")
    cells = [p_number(p_values[a.folder, b.folder, m.name]) for m in measures()]
    yield Row("p", [*cells, empty], kind="test")
    better = [improvement_of(a.values(m.name), b.values(m.name), m) for m in measures()]
    yield Row("P(B better)", [*map(number_of, better), empty], kind="test")


def _lowest_p(a: int, b: int) -> float:
    """Least p value of a two-sided permutation test of a runs against b: where all of one side lie
    above the other's, only that division and, of equal numbers, its mirror are as extreme."""
    return (2 if a == b else 1) / math.comb(a + b, a)


def _difference_name(a: Group, b: Group) -> str:
    titles = [name_of(group) for group in (b, a)]
    return f"B - A: {titles[0] if titles[0] == titles[1] else ' - '.join(titles)}"


def _lines(sides: Sides) -> Iterator[Line]:
    """Every number of both sides, for a program."""
    for name, groups in zip("AB", sides, strict=True):
        for group in groups:
            yield from group_lines(group, f"{name}: ")
    for of_a, of_b in _pairs(sides):
        yield from difference_lines(of_a, of_b, _difference_name(of_a, of_b))


def _notes(task: str, sides: Sides, tests: int) -> list[str]:
    """Runs too few for an interval or a test; tests: how many p values are corrected for."""
    sizes = {(len(a.runs), len(b.runs)) for a, b in _pairs(sides)}
    lowest = {(a, b): min(1.0, tests * _lowest_p(a, b)) for a, b in sorted(sizes) if min(a, b) > 1}
    notes = [
        f"{task}: of {a} runs against {b} no p here can be below {p:.3g}, however far they differ: "
        "they decide nothing."
        for (a, b), p in lowest.items()
        if p > LEVEL
    ]
    for name, group in sides.named:
        if len(group.runs) == 1:
            notes.append(f"{task}, {name} has one seed: no interval, and no test.")
    return notes
