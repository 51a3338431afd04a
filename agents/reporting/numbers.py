"""The numbers of a report for a program: one CSV table of whole precision."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator, Mapping, Sequence

from agents.algorithms import title
from agents.reporting.tables import Reference, ends_words
from agents.results.frame import name_of
from agents.results.measures import measures
from agents.results.reading import Group
from agents.results.statistics import Difference, group_mean, known, places, within_limit
from emcc import Interval, iqm

Line = Sequence[str | int | float | None]
SHARE = ("seeds", "share", "share_low", "share_high")
"""Columns of a share of seeds: their number, the share, and its 95 % interval."""


def numbers_csv(lines: Iterable[Line]) -> str:
    """Lines as CSV below their head. A float is written with all its digits; a measure that is not
    known is empty.

    algorithm: with the settings that are not its preset's; in a comparison "A: ", "B: " or
    "B - A: " before it. kind: "run", "paper", "mean" over as many seeds as its line tells, "iqm"
    (interquartile mean), or "difference" of two sides' means with "p" (permutation test, not
    corrected) and "improvement" (probability that a run of B is better). Behind them " low" and
    " high" are the ends of the 95 % interval, " lowest" and " highest" those of the seeds where no
    interval is given. "ends in" and "within limit" are shares of the seeds, in columns of their
    own. folder: of the runs, below the report's or its side's.
    """
    text = io.StringIO()
    names = [m.name for m in measures()]
    head = ["task", "algorithm", "kind", "seed", *names, *SHARE, "ends_in", "folder"]
    csv.writer(text, lineterminator="\n").writerows([head, *lines])
    return text.getvalue()


def report_lines(groups: Sequence[Group], printed: Reference) -> Iterator[Line]:
    """Means and runs of every group, then the printed numbers of the same algorithms."""
    yield from group_lines(groups)
    known = {(g.task, g.config.algorithm): found for g in groups if (found := printed(g))}
    for (task, name), reference in known.items():
        yield _line(task, title(name), "paper", reference.values)


def group_lines(groups: Sequence[Group], prefix: str = "") -> Iterator[Line]:
    """The means of each group with their intervals and its shares, then its runs."""
    for group in groups:
        task, name, folder = group.task, prefix + name_of(group), group.folder
        if group.runs:
            means = {m.name: group_mean(group, m.name) for m in measures()}
            yield from _interval_lines(task, name, "mean", means, folder, len(group.runs))
            values = {m.name: known(group.values(m.name)) for m in measures()}
            middle = {name: iqm(numbers) for name, numbers in values.items() if numbers}
            yield _line(task, name, "iqm", middle, folder)
            shares = [("ends in", place, share) for place, share in places(group).items()]
            if share := within_limit(group):
                shares.append(("within limit", "", share))
            for kind, place, share in shares:
                told = (share.runs, share.value, share.low, share.high)
                yield _line(task, name, kind, {}, folder, ends=place, share=told)
        for run in group.runs:
            yield _line(task, name, "run", run.measures, folder, run.seed, ends_words(run))


def difference_lines(task: str, name: str, told: Mapping[str, Difference]) -> Iterator[Line]:
    """B - A of each measure, its p value, and the probability that B is better."""
    yield from _interval_lines(task, name, "difference", {m: d.gap for m, d in told.items()})
    yield _line(task, name, "p", {m: d.p for m, d in told.items()})
    yield from _interval_lines(task, name, "improvement", {m: d.better for m, d in told.items()})


def _interval_lines(
    task: str,
    name: str,
    kind: str,
    means: Mapping[str, Interval | None],
    folder: str = "",
    seeds: int | str = "",
) -> Iterator[Line]:
    known = {measure: mean for measure, mean in means.items() if mean is not None}
    values = {measure: mean.value for measure, mean in known.items()}
    if values:
        yield _line(task, name, kind, values, folder, share=(seeds, "", "", ""))
    ranges = any(mean.kind == "range" for mean in known.values())
    for end, words in (("low", "lowest"), ("high", "highest")):
        ends = {m: getattr(mean, end) for m, mean in known.items()}
        if any(value is not None for value in ends.values()):
            yield _line(task, name, f"{kind} {words if ranges else end}", ends, folder)


def _line(
    task: str,
    name: str,
    kind: str,
    values: Mapping[str, float | None],
    folder: str = "",
    seed: int | str = "",
    ends: str = "",
    share: Sequence[float | str] = ("", "", "", ""),
) -> Line:
    numbers = [values.get(m.name) for m in measures()]
    return [task, name, kind, seed, *numbers, *share, ends, folder]
