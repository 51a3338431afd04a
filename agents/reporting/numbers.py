"""The numbers of a report for programs, as CSV at full precision."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator, Mapping, Sequence

from agents.algorithms import title
from agents.reporting.tables import ends_words
from agents.results.frame import COLUMNS, rows
from agents.results.groups import Group
from agents.results.measures import measures
from agents.results.statistics import Difference, group_mean, known, places, within_limit
from emcc import Interval, iqm

Line = Mapping[str, str | int | float | None]
"""Cells by column heading; missing ones are written as empty."""


def numbers_csv(lines: Iterable[Line]) -> str:
    """Return lines as CSV with a heading. Floats have all their digits; unknown measures are empty.

    Columns: algorithm: with the settings that differ from its preset; a comparison puts "A: ",
    "B: " or "B - A: " in front. kind: "run", "paper", "mean" over the number of seeds in the line,
    "iqm" (interquartile mean), or "difference" of the two sides' means, with "p" (permutation test,
    not corrected) and "improvement" (probability that a run of B is better). A kind ending in
    " low" or " high" has the ends of the 95 % interval; " lowest" or " highest" has the extreme
    seeds where there is no interval. "ends in" and "within limit" are shares of the seeds, with
    columns of their own. folder: of the runs, relative to that of the report or of the side.
    """
    head = ["task", "algorithm", "kind", "seed", *(m.name for m in measures())]
    head += ["seeds", "share", "share_low", "share_high", "ends_in", "folder"]
    text = io.StringIO()
    table = csv.DictWriter(text, head, extrasaction="ignore", lineterminator="\n")
    table.writeheader()
    table.writerows(lines)
    return text.getvalue()


def measures_csv(groups: Sequence[Group]) -> str:
    """Return the tidy rows of `agents.results.frame.rows` as CSV; unknown values are empty."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([COLUMNS, *rows(groups)])
    return text.getvalue()


def report_lines(groups: Sequence[Group]) -> Iterator[Line]:
    """Yield means and runs of every group, then the published numbers of the same algorithms."""
    yield from group_lines(groups)
    printed = {(g.task, g.config.algorithm): g.printed for g in groups if g.printed}
    for (task, name), values in printed.items():
        yield {"task": task, "algorithm": title(name), "kind": "paper", **values}


def group_lines(groups: Sequence[Group], prefix: str = "") -> Iterator[Line]:
    """Yield for each group the means with their intervals, the shares, and the runs."""
    for group in groups:
        about = {"task": group.task, "algorithm": prefix + group.full_name, "folder": group.folder}
        if group.runs:
            means = {m.name: group_mean(group, m.name) for m in measures()}
            yield from _interval_lines(about, "mean", means, len(group.runs))
            values = {m.name: known(group.values(m.name)) for m in measures()}
            middle = {name: iqm(numbers) for name, numbers in values.items() if numbers}
            yield about | {"kind": "iqm"} | middle
            shares = [("ends in", place, share) for place, share in places(group).items()]
            if share := within_limit(group):
                shares.append(("within limit", "", share))
            for kind, place, share in shares:
                told = {"kind": kind, "ends_in": place, "seeds": share.runs, "share": share.value}
                yield about | told | {"share_low": share.low, "share_high": share.high}
        for run in group.runs:
            told = {"kind": "run", "seed": run.seed, "ends_in": ends_words(run)}
            yield {**about, **told, **run.measures}


def difference_lines(task: str, name: str, told: Mapping[str, Difference]) -> Iterator[Line]:
    """Yield B - A of each measure, its p value, and the probability that B is better."""
    about = {"task": task, "algorithm": name}
    yield from _interval_lines(about, "difference", {m: d.gap for m, d in told.items()})
    yield about | {"kind": "p"} | {m: d.p for m, d in told.items()}
    yield from _interval_lines(about, "improvement", {m: d.better for m, d in told.items()})


def _interval_lines(
    about: Mapping[str, str],
    kind: str,
    means: Mapping[str, Interval | None],
    seeds: int | None = None,
) -> Iterator[Line]:
    known = {measure: mean for measure, mean in means.items() if mean is not None}
    if known:
        values = {measure: mean.value for measure, mean in known.items()}
        yield {**about, "kind": kind, "seeds": seeds, **values}
    ranges = any(mean.kind == "range" for mean in known.values())
    for end, words in (("low", "lowest"), ("high", "highest")):
        ends = {m: getattr(mean, end) for m, mean in known.items()}
        if any(value is not None for value in ends.values()):
            yield {**about, "kind": f"{kind} {words if ranges else end}", **ends}
