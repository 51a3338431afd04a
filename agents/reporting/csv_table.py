"""The numbers of a report for a program: one CSV table of whole precision."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator, Mapping, Sequence

from agents.algorithms import title
from agents.paper.printed import paper_results
from agents.paper.settings import title_of
from agents.reporting.tables import ends_words
from agents.results.measures import measures
from agents.results.reading import Group
from agents.results.statistics import difference_of, mean_of
from emcc import Difference, Estimate

Line = Sequence[str | int | float | None]


def numbers_csv(lines: Iterable[Line]) -> str:
    """Lines as CSV below their head. A float is written with all its digits; a measure that is not
    known is empty.

    algorithm: with the settings that are not its preset's; in a comparison "A: ", "B: " or
    "B - A: " before it. kind: "run", "paper", "mean" over the seeds or "difference" of two sides'
    means; the last two with " low" and " high" for the ends of their intervals, where there are
    several seeds. folder: of the runs, below the report's or its side's.
    """
    text = io.StringIO()
    names = [measure.name for measure in measures()]
    head = ["task", "algorithm", "kind", "seed", *names, "ends_in", "folder"]
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
    """The means of a group with their intervals, then its runs."""
    task, name = group.config.task, prefix + title_of(group.config)
    found = {measure.name: mean_of(group.values(measure.name)) for measure in measures()}
    if group.runs:
        yield from _interval_lines(task, name, "mean", found, group.folder)
    for run in group.runs:
        yield from _line(task, name, "run", run.measures, group.folder, run.seed, ends_words(run))


def difference_lines(a: Group, b: Group, name: str) -> Iterator[Line]:
    """B - A."""
    found = {m.name: difference_of(a.values(m.name), b.values(m.name)) for m in measures()}
    yield from _interval_lines(b.config.task, name, "difference", found)


def _interval_lines(
    task: str,
    name: str,
    kind: str,
    found: Mapping[str, Estimate | Difference | None],
    folder: str = "",
) -> Iterator[Line]:
    known = {measure: of for measure, of in found.items() if of is not None}
    yield from _line(task, name, kind, {m: of.value for m, of in known.items()}, folder)
    lows = {m: of.low for m, of in known.items() if of.low is not None}
    highs = {m: of.high for m, of in known.items() if of.high is not None}
    yield from _line(task, name, f"{kind} low", lows, folder)
    yield from _line(task, name, f"{kind} high", highs, folder)


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
        yield [task, name, kind, seed, *(values.get(m.name) for m in measures()), ends, folder]
