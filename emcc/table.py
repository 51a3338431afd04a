"""Runs -> rows of text -> a table as plain text, Markdown or CSV."""

import csv
import io
import json
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from emcc.interval import estimate
from emcc.parts import cost_rate, rollouts_by_part
from emcc.readers import EpisodeSums, Run
from emcc.streaks import streak_bounds
from emcc.tail import emcc

MISSING = "\N{EN DASH}"
FORMATS = ("text", "md", "csv")


@dataclass(frozen=True)
class Table:
    """Cells of text, with what has to be said above and below them."""

    caption: str
    head: list[str]
    rows: list[list[str]]
    notes: list[str]
    marked: frozenset[tuple[int, int]] = frozenset()
    """Row and column of the cells whose value stands out: bold in Markdown, as ever elsewhere."""
    marking: str = ""
    """What a mark says."""
    complete: bool = True
    """Whether no number is missing."""

    @property
    def legend(self) -> str:
        """The caption, and what a mark says where there are marks."""
        return self.caption + (f"; bold: {self.marking}" if self.marked else "")

    def render(self, form: str) -> str:
        """Lines of aligned text, Markdown, or CSV whose comment lines begin with '#'."""
        notes = [f"Note: {note}" for note in self.notes]
        if form == "csv":
            body = io.StringIO()
            csv.writer(body, lineterminator="\n").writerows([self.head, *self.rows])
            comments = [f"# {line}" for line in (self.caption, *notes)]
            return "\n".join([*comments, body.getvalue()])
        lines = [self.head, *self.rows]
        if form == "md":
            lines = [self.head, ["---"] * len(self.head), *self._bold_rows()]
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        padded = [
            [cell.ljust(width) for cell, width in zip(line, widths, strict=True)] for line in lines
        ]
        if form == "md":
            body = [f"| {' | '.join(line)} |" for line in padded]
            notes = [line for note in notes for line in ("", note)]  # a paragraph each
        else:
            body = ["  ".join(line).rstrip() for line in padded]
            notes = ["", *notes] if notes else []
        return "\n".join([self.legend if form == "md" else self.caption, "", *body, *notes, ""])

    def _bold_rows(self) -> list[list[str]]:
        """The rows with marked values in bold; the interval behind a value is not."""
        return [
            [
                re.sub(r"^(\S+)", r"**\1**", cell) if (row, column) in self.marked else cell
                for column, cell in enumerate(cells)
            ]
            for row, cells in enumerate(self.rows)
        ]


def emcc_table(
    runs: Sequence[Run], alpha: float, ties: str, seed: int = 0, per_run: bool = False
) -> Table:
    """One row per task, algorithm and settings: means over its runs; with per_run, they follow.

    seed: of the bootstrap. Runs without a task and an algorithm have a row each.
    ValueError: alpha, ties or the steps of a run are not allowed.
    """
    measures = {run: _measures(run, alpha, ties) for run in runs}
    groups: dict[tuple[str, str, str], list[Run]] = {}
    for run in runs:
        key = (run.task, run.algorithm or str(run.path), run.settings)
        groups.setdefault(key, []).append(run)
    rows = []
    for key, members in groups.items():
        label = [key[0] or MISSING, _name(key, list(groups))]
        rows.append([*label, str(len(members)), *_cells(members, measures, seed)])
        if per_run:
            for run in members:
                rows.append([*label, f"seed {run.seed or '?'}", *_cells([run], measures, seed)])
    caption = (
        f"EMCC with alpha = {alpha:g}, ties = {ties}: {_READINGS[ties]} in each third of training; "
        "means over runs [95 % bootstrap interval]"
    )
    names = list(measures[runs[0]])
    return Table(
        caption,
        ["task", "algorithm", "runs", "steps", "steps from", *names],
        rows,
        [note for run in runs for note in _notes(run, measures[run])] + _repeated_seeds(groups),
        complete=all(
            value is not None for of_run in measures.values() for value in of_run.values()
        ),
    )


def _name(key: tuple[str, str, str], keys: Sequence[tuple[str, str, str]]) -> str:
    """The algorithm, with its settings that differ where others have its name on the same task."""
    others = [_flat(json.loads(other[2])) for other in keys if other[:2] == key[:2] and other[2]]
    if len(others) < 2 or not key[2]:
        return key[1]
    told = []
    for name, value in _flat(json.loads(key[2])).items():
        if any(other.get(name) != value for other in others):
            told.append(f"{name} {value}")
    return f"{key[1]} ({', '.join(told)})" if told else key[1]


def _flat(settings: dict[str, Any]) -> dict[str, Any]:
    """The entries of a kind of settings, or what stands there instead, by name."""
    found: dict[str, Any] = {}
    for kind, values in settings.items():
        found |= values if isinstance(values, dict) else {kind: values}
    return found


_READINGS = {
    "all": "mean of all MCC values at or above the (1 - alpha) quantile",
    "split": "mean of exactly the share alpha of highest MCC values",
}


def _measures(run: Run, alpha: float, ties: str) -> dict[str, float | None]:
    """The numbers of one run; None where no rollout has started yet."""
    try:
        parts = rollouts_by_part(run.start_steps, run.total_steps)
    except ValueError as error:
        raise ValueError(
            f"{run.path}: {error}; total steps are from {run.total_from}, --total-steps sets them"
        ) from None
    values: dict[str, float | None] = {
        f"EMCC_{part}": emcc(run.mcc[where], alpha, ties) if where.any() else None
        for part, where in parts.items()
    }
    return values | {"cost rate": cost_rate(run.cost, run.steps) if run.steps else None}


def _cells(runs: list[Run], measures: dict[Run, dict[str, float | None]], seed: int) -> list[str]:
    steps = ", ".join(dict.fromkeys(str(run.total_steps) for run in runs))
    source = ", ".join(dict.fromkeys(run.total_from for run in runs))
    names = measures[runs[0]]
    return [steps, source, *(_mean([measures[run][name] for run in runs], seed) for name in names)]


def _mean(values: list[float | None], seed: int) -> str:
    known = [value for value in values if value is not None]
    if len(known) < len(values):
        return MISSING
    # A generator of its own: no cell depends on which others the table has.
    result = estimate({"": known}, rng=np.random.default_rng(seed))[""]
    interval = "" if result.low is None else f" [{result.low:.3f}, {result.high:.3f}]"
    return f"{result.value:.3f}{interval}"


def _notes(run: Run, measures: dict[str, float | None]) -> list[str]:
    notes = []
    if run.steps < run.total_steps:
        notes.append(f"{run.path} is unfinished: {run.steps} of {run.total_steps} steps.")
    missing = [name for name, value in measures.items() if value is None]
    if missing:
        notes.append(f"{run.path} has no rollout yet for {', '.join(missing)}.")
    return notes


def _repeated_seeds(groups: dict[tuple[str, str, str], list[Run]]) -> list[str]:
    return [
        f"{task} {algorithm}: {times} runs have seed {seed}; their interval may be too narrow."
        for (task, algorithm, _), runs in groups.items()
        for seed, times in Counter(run.seed for run in runs if run.seed).items()
        if times > 1
    ]


def bounds_table(sums: Sequence[EpisodeSums]) -> Table:
    """What sums of episodes can tell: the bounds of longest streak / length, and the cost rate."""
    rows = []
    for entry in sums:
        low, high = streak_bounds(entry.unsafe_steps, entry.length)
        shares = [f"{(bound / entry.length).mean():.3f}" for bound in (low, high)]
        rate = f"{cost_rate(entry.unsafe_steps, entry.length):.3f}"
        rows.append([str(entry.path), str(len(low)), str(entry.length.sum()), *shares, rate])
    return Table(
        "Bounds, not EMCC: longest streak / length, means over all episodes. The sum of an "
        "episode's costs does not tell in which order they came.",
        ["file", "episodes", "steps", "at least", "at most", "cost rate"],
        rows,
        [],
    )
