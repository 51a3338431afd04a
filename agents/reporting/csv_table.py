"""The numbers of a report for a program: one CSV table of whole precision."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator, Mapping, Sequence

from agents.algorithms import title
from agents.paper.printed import paper_results
from agents.paper.settings import cost_limit, name_of
from agents.reporting.tables import ends_words
from agents.results.measures import measures
from agents.results.over_tasks import TwoSets, common_measures
from agents.results.reading import Group
from agents.results.statistics import (
    group_difference,
    group_mean,
    improvement_of,
    iqm_of,
    p_of,
    places,
    within_limit,
)
from emcc import Interval, Share

Line = Sequence[str | int | float | None]
SHARE = ("seeds", "share", "share_low", "share_high")
"""Columns of a share of seeds: their number, the share, and its 95 % interval."""


def numbers_csv(lines: Iterable[Line]) -> str:
    """Lines as CSV below their head. A float is written with all its digits; a measure that is not
    known is empty.

    algorithm: with the settings that are not its preset's; in a comparison "A: ", "B: " or
    "B - A: " before it. kind: "run", "paper", "mean" over the seeds, "iqm" (interquartile mean), or
    "difference" of two sides' means with "p" (permutation test, not corrected) and "improvement"
    (probability that a run of B is better). Behind them " low" and " high" are the ends of the 95 %
    interval, " lowest" and " highest" those of the seeds where no interval is given. "ends in" and
    "within limit" are shares of the seeds, in columns of their own. folder: of the runs, below the
    report's or its side's.
    """
    text = io.StringIO()
    names = [measure.name for measure in measures()]
    head = ["task", "algorithm", "kind", "seed", *names, *SHARE, "ends_in", "folder"]
    csv.writer(text, lineterminator="\n").writerows([head, *lines])
    return text.getvalue()


def report_lines(groups: Sequence[Group]) -> Iterator[Line]:
    """Means and runs of every group, then what the paper prints of the same algorithms."""
    for group in groups:
        yield from group_lines(group)
    of_paper = dict.fromkeys((group.config.task, group.config.algorithm) for group in groups)
    for task, name in of_paper:
        yield from _line(task, title(name), "paper", paper_results(task, title(name)))


def group_lines(group: Group, prefix: str = "") -> Iterator[Line]:
    """The means of a group with their intervals and its shares, then its runs."""
    task, name, folder = group.config.task, prefix + name_of(group), group.folder
    if group.runs:
        found = {measure.name: group_mean(group, measure.name) for measure in measures()}
        yield from _interval_lines(task, name, "mean", found, folder)
        middle = {measure.name: iqm_of(group.values(measure.name)) for measure in measures()}
        yield from _line(task, name, "iqm", middle, folder)
        for place, share in places(group).items():
            yield _share_line(task, name, "ends in", share, folder, place)
        if share := within_limit(group, cost_limit(group.config)):
            yield _share_line(task, name, "within limit", share, folder)
    for run in group.runs:
        yield from _line(task, name, "run", run.measures, folder, run.seed, ends_words(run))


def difference_lines(a: Group, b: Group, name: str) -> Iterator[Line]:
    """B - A."""
    task, names = b.config.task, [m.name for m in measures()]
    gaps = {measure: group_difference(a, b, measure) for measure in names}
    yield from _interval_lines(task, name, "difference", gaps)
    p_values = {measure: p_of(a.values(measure), b.values(measure)) for measure in names}
    yield from _line(task, name, "p", p_values)
    better = {m.name: improvement_of(a.values(m.name), b.values(m.name), m) for m in measures()}
    yield from _interval_lines(task, name, "improvement", better)


def two_sets_lines(sets: TwoSets, name: str) -> Iterator[Line]:
    """B - A over all tasks, of the measures that tasks share."""
    task, columns = f"{sets.tasks} tasks", common_measures()
    gaps = {m.name: sets.difference(m) for m in columns}
    yield from _interval_lines(task, name, "difference", gaps)
    yield from _line(task, name, "p", {m.name: sets.p(m) for m in columns})
    better = {m.name: sets.improvement(m) for m in columns}
    yield from _interval_lines(task, name, "improvement", better)


def _interval_lines(
    task: str,
    name: str,
    kind: str,
    found: Mapping[str, Interval | None],
    folder: str = "",
) -> Iterator[Line]:
    known = {measure: of for measure, of in found.items() if of is not None}
    yield from _line(task, name, kind, {m: of.value for m, of in known.items()}, folder)
    ranges = any(of.kind == "range" for of in known.values())
    for end, words in (("low", "lowest"), ("high", "highest")):
        values = {m: getattr(of, end) for m, of in known.items() if getattr(of, end) is not None}
        yield from _line(task, name, f"{kind} {words if ranges else end}", values, folder)


def _share_line(task: str, name: str, kind: str, share: Share, folder: str, ends: str = "") -> Line:
    empty = [None for _ in measures()]
    of = [share.runs, share.value, share.low, share.high]
    return [task, name, kind, "", *empty, *of, ends, folder]


def _line(
    task: str,
    name: str,
    kind: str,
    values: Mapping[str, float | None],
    folder: str = "",
    seed: int | str = "",
    ends: str = "",
) -> Iterator[Line]:
    """A line, or none where there are no measures."""
    if values:
        numbers = [values.get(m.name) for m in measures()]
        yield [task, name, kind, seed, *numbers, *[None for _ in SHARE], ends, folder]
