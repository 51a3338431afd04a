"""Two sets of runs side by side, with the differences of their means."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from agents.errors import UserError, nearest
from agents.reporting.figures import curves
from agents.reporting.numbers import difference_lines, group_lines, numbers_csv
from agents.reporting.overall import TASKS, differences_over_tasks
from agents.reporting.page import Section, page
from agents.reporting.provenance import made
from agents.reporting.table import Number, Table, corrected, latex, markdown
from agents.reporting.tables import (
    caption,
    caption_in_paper,
    difference_rows,
    lengths_differ,
    long_settings,
    mean_row,
    measures_table,
    run_rows,
    unequal_lengths,
)
from agents.results.groups import Group, name_of_all, under_one_id
from agents.results.measures import measures
from agents.results.names import changes, in_order, with_names
from agents.results.reading import read_groups
from agents.results.statistics import (
    ACROSS_WORDS,
    LEVEL,
    Difference,
    Pair,
    alike,
    differences,
    holm,
    mixed,
    only,
    pairs_over_tasks,
)
from agents.training.files import check_folder, write_whole

METHOD = (
    "B - A: difference of the means [Welch's 95 % t interval, of five seeds or more on both sides "
    "that end in one place]; p: two-sided permutation test of Welch's t{}; P(B better): "
    "probability that a run of B is better than one of A, equal ones half [95 % bootstrap interval]"
)
Tested = Mapping[tuple[str, str], Mapping[str, Difference]]
"""Differences between the groups of each pair, by task and pair name."""


class Sides(NamedTuple):
    """The complete runs of two folders on one task."""

    a: list[Group]
    b: list[Group]

    @property
    def named(self) -> list[tuple[str, Group]]:
        """All groups of both sides, each with its name."""
        sides = zip(("A", "B"), self, strict=True)
        return [(f"{k}: {g.name}", g) for k, groups in sides for g in groups]

    @property
    def pairs(self) -> dict[str, Pair]:
        """Pairs of groups to compare, by name.

        A group of B is paired with the group of A that has the same algorithm, settings and cost,
        or, if there is none, with every group of A of the same cost."""
        pairs: list[Pair] = []
        for b in self.b:
            of_cost = [a for a in self.a if a.cost == b.cost]
            same = [a for a in of_cost if _settings(a) == _settings(b)]
            pairs += [(a, b) for a in same or of_cost]
        return {_name(a.name, b.name): (a, b) for a, b in pairs}


def compare(
    a: Path, b: Path, out: Path | None = None, asked: Sequence[str] | None = None
) -> list[Table]:
    """Return the tables of two folders of runs with the differences B - A, by task and over tasks.

    The pairs are those of `Sides.pairs`. The last table tests, over all tasks together, each pair
    that occurs on two tasks or more. asked: names of the measures to test, by default all.
    Otherwise see `agents.compare`.
    """
    for name in () if asked is None else asked:
        if name not in (known := [m.name for m in measures()]):
            raise UserError(f"there is no measure {name!r}: {nearest(name, known)}")
    if out is not None:
        check_folder(out)
    notes = [f"A is {a}, B is {b}."]
    of_a, of_b = (read_groups([side], notes) for side in (a, b))
    if mixed([*of_a, *of_b]):
        notes.append(ACROSS_WORDS)
    both = under_one_id(alike([*of_a, *of_b]))
    sides = [with_names(side, both) for side in (both[: len(of_a)], both[len(of_a) :])]
    by_task = _by_task(a, b, sides, notes)
    pairs = {(task, k): pair for task, both in by_task.items() for k, pair in both.pairs.items()}
    tested = {key: only(asked, differences(*pair)) for key, pair in pairs.items()}
    over_tasks = pairs_over_tasks((name, pair) for (_, name), pair in pairs.items())
    adjusted, tests = holm(tested)
    *_, last = by_task
    tables = {
        task: _table(task, both, adjusted, tests, notes if task == last else [])
        for task, both in by_task.items()
    }
    if (together := differences_over_tasks(over_tasks, asked)) is not None:
        tables[TASKS] = together
    if out is None:
        return list(tables.values())
    out.mkdir(parents=True, exist_ok=True)
    drawn = {task: [curves(both.named)] for task, both in by_task.items()}
    sections = [Section(name, table, drawn.get(name, [])) for name, table in tables.items()]
    named = list(zip("AB", sides, strict=True))
    how = {f"{side}, {k}": text for side, groups in named for k, text in made(groups).items()}
    title = " and ".join(f"{name_of_all(groups)} ({side})" for side, groups in named)
    write_whole(out / "compare.html", page(title, sections, how))
    write_whole(out / "compare.md", markdown(list(tables.values())))
    write_whole(out / "compare.tex", latex(tables))
    lines = []
    for task, both in by_task.items():
        for name, groups in zip("AB", both, strict=True):
            lines += group_lines(groups, f"{name}: ")
        for name, (one, other) in both.pairs.items():
            called = _name(one.full_name, other.full_name)
            lines += difference_lines(task, called, tested[task, name])
    for (name, tasks, _), told in over_tasks.items():
        lines += difference_lines(tasks, name, only(asked, told))
    write_whole(out / "compare.csv", numbers_csv(lines))
    return list(tables.values())


def _by_task(
    a: Path, b: Path, sides: Sequence[Sequence[Group]], notes: list[str]
) -> dict[str, Sides]:
    """Return the runs on the tasks that both sides have; add notes on other tasks."""
    complete = [[group for group in side if group.runs] for side in sides]
    tasks = [list(dict.fromkeys(group.task for group in groups)) for groups in complete]
    common = [task for task in tasks[0] if task in tasks[1]]
    if not common:
        raise UserError(
            f"{a} and {b} have no task in common: {', '.join(tasks[0])} against "
            f"{', '.join(tasks[1])}"
        )
    for name, own in zip("AB", tasks, strict=True):
        alone = [task for task in own if task not in common]
        notes += [f"only {name} has runs on {', '.join(alone)}."] if alone else []
    return {
        task: Sides(*([group for group in side if group.task == task] for side in complete))
        for task in common
    }


def _table(task: str, sides: Sides, tested: Tested, tests: int, notes: Sequence[str]) -> Table:
    """Return the table of a task: means of both sides, the differences, then every run.

    tested: the differences, with corrected p values; tests: the number of p values.
    """
    rows = [mean_row(group, name) for name, group in sides.named]
    beside = [Number(None)] * 2
    for name in sides.pairs:
        rows += difference_rows(name, tested[task, name], measures(), tests, beside=beside)
    for prefix, groups in zip(("A: ", "B: "), sides, strict=True):
        rows += [row for group in in_order(groups) for row in run_rows(group, prefix)]
    groups = [*sides.a, *sides.b]
    told = [f"{task}: {note}" for note in (*long_settings(groups), *unequal_lengths(groups))]
    words = f"{caption(groups)}; {METHOD.format(corrected(tests, 'made here'))}"
    notes = [*notes, *told, *_too_few(task, sides, tests)]
    made = measures_table(words, task, rows, notes, lengths=lengths_differ(groups))
    return replace(made, in_paper=caption_in_paper(groups))


def _settings(group: Group) -> tuple[str, dict[str, Any]]:
    return group.config.algorithm, changes(group.config, group.task)


def _name(a: str, b: str) -> str:
    return f"B - A: {a if a == b else f'{b} - {a}'}"


def _too_few(task: str, sides: Sides, number_of_tests: int) -> list[str]:
    """Return notes on sides with too few runs for an interval or a significant test."""
    sizes = {(len(a.runs), len(b.runs)) for a, b in sides.pairs.values()}
    notes = []
    for a, b in sorted(sizes):
        least = min(1.0, number_of_tests * _lowest_p(a, b))
        if min(a, b) > 1 and least > LEVEL:
            notes.append(
                f"{task}: with {a} runs against {b}, no p here can be below {least:.3g}, however "
                "far they differ, so the tests decide nothing."
            )
    single = [name for name, group in sides.named if len(group.runs) == 1]
    return notes + [f"{task}, {name} has one seed: no interval, and no test." for name in single]


def _lowest_p(a: int, b: int) -> float:
    """Return the least p value of a two-sided permutation test of `a` runs against `b`.

    If all runs of one side are above the other's, only that split is as extreme, and its mirror if
    both sides have equally many runs."""
    return (2 if a == b else 1) / math.comb(a + b, a)
