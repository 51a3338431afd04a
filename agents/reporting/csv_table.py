"""The numbers of a report for a program: one CSV table of whole precision."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from agents.algorithms import algorithm
from agents.reporting.tables import difference_of, mean_of, paper_results, title_of
from agents.results.reading import MEASURES, Group
from emcc import Difference, Estimate

HEAD = ("task", "algorithm", "kind", "seed", *MEASURES, "ends_in", "folder")

Line = tuple[str | int | float, ...]


def numbers_csv(lines: Iterable[Line]) -> str:
    """Lines as CSV below their head. A float is written with all its digits.

    algorithm: with the settings that are not its preset's; in a comparison "A: ", "B: " or
    "B - A: " before it. kind: "run", "paper", "mean" over the seeds or "difference" of two sides'
    means; the last two with " low" and " high" for the ends of their intervals, where there are
    several seeds. folder: of the runs, below the report's or its side's.
    """
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([HEAD, *lines])
    return text.getvalue()


def report_lines(folder: Path, groups: Sequence[Group]) -> Iterator[Line]:
    """Of every group below a folder its means and runs, then what the paper prints of the same
    algorithms."""
    for group in groups:
        yield from group_lines(folder, group)
    of_paper = dict.fromkeys((group.config.task, group.config.algorithm) for group in groups)
    for task, name in of_paper:
        title = algorithm(name).title
        yield from _line(task, title, "paper", paper_results(task, title))


def group_lines(folder: Path, group: Group, prefix: str = "") -> Iterator[Line]:
    """The means of a group with their intervals, then its runs."""
    task, name = group.config.task, prefix + title_of(group.config)
    where = str(group.folder.relative_to(folder))
    if group.runs:
        found = {m: mean_of([run.measures[m] for run in group.runs]) for m in MEASURES}
        yield from _interval_lines(task, name, "mean", found, where)
    for run in group.runs:
        yield from _line(task, name, "run", run.measures, where, run.seed, run.ends)


def difference_lines(a: Group, b: Group, name: str) -> Iterator[Line]:
    """B - A."""
    found = {m: difference_of(a.runs, b.runs, m) for m in MEASURES}
    yield from _interval_lines(b.config.task, name, "difference", found)


def _interval_lines(
    task: str,
    name: str,
    kind: str,
    found: Mapping[str, Estimate | Difference],
    folder: str = "",
) -> Iterator[Line]:
    yield from _line(task, name, kind, {m: of.value for m, of in found.items()}, folder)
    lows = {m: of.low for m, of in found.items() if of.low is not None}
    highs = {m: of.high for m, of in found.items() if of.high is not None}
    yield from _line(task, name, f"{kind} low", lows, folder)
    yield from _line(task, name, f"{kind} high", highs, folder)


def _line(
    task: str,
    name: str,
    kind: str,
    measures: Mapping[str, float],
    folder: str = "",
    seed: int | str = "",
    ends: str = "",
) -> Iterator[Line]:
    """A line, or none where there are no measures."""
    if measures:
        yield (task, name, kind, seed, *(measures[m] for m in MEASURES), ends, folder)
