"""A table of text cells, and its forms: plain text, Markdown, CSV, LaTeX."""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from emcc.interval import estimate
from emcc.statistics import FEWEST_RUNS, UNBOUNDED, Bounds, has_scipy, mean_interval

MISSING = "\N{EN DASH}"
FORMATS = ("text", "md", "csv", "latex")
Rows = list[list[str]]
FEWEST_RESAMPLED = 10
"""Runs that a bootstrap interval of a mean needs: of five it covers 83 % instead of 95 %."""


@dataclass(frozen=True)
class Table:
    """Cells of text, with a caption above and notes below them."""

    caption: str
    head: list[str]
    rows: Rows
    notes: list[str]
    complete: bool = True
    """Whether no number is missing."""

    def render(self, form: str) -> str:
        """Lines of aligned text, Markdown, CSV whose comment lines begin with '#', or LaTeX's
        tabular with the rules of booktabs, whose comment lines begin with '%'."""
        notes = [f"Note: {note}" for note in self.notes]
        if form == "csv":
            body = io.StringIO()
            csv.writer(body, lineterminator="\n").writerows([self.head, *self.rows])
            comments = [f"# {line}" for line in (self.caption, *notes)]
            return "\n".join([*comments, body.getvalue()])
        if form == "latex":
            return self._latex([f"% {line}" for line in (self.caption, *notes)])
        lines = [self.head, *self.rows]
        if form == "md":
            lines = [self.head, ["---"] * len(self.head), *self.rows]
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
        return "\n".join([self.caption, "", *body, *notes, ""])

    def _latex(self, comments: list[str]) -> str:
        head, *rows = (" & ".join(map(_escape, row)) + r" \\" for row in (self.head, *self.rows))
        first = rf"\begin{{tabular}}{{l{'r' * (len(self.head) - 1)}}}"
        top, end = (first, r"\toprule", head, r"\midrule"), (r"\bottomrule", r"\end{tabular}")
        return "\n".join([*comments, *top, *rows, *end, ""])


def intervals() -> str:
    """Meaning of the brackets in the cell of a mean."""
    if has_scipy():
        return f"[95 % t interval], or the range of fewer than {FEWEST_RUNS} runs"
    return (
        f"[95 % bootstrap interval], or the range of fewer than {FEWEST_RESAMPLED} runs, whose "
        "t interval needs scipy>=1.15"
    )


def mean_cell(
    values: Sequence[float | None], digits: int, seed: int, bounds: Bounds = UNBOUNDED
) -> str:
    """Mean over runs with its interval or range, see `intervals`; a dash where a run has no value.

    seed: of the bootstrap, which is there for tables without scipy. bounds: see `mean_interval`.
    """
    known = [value for value in values if value is not None]
    if len(known) < len(values):
        return MISSING
    if len(known) == 1:
        return f"{known[0]:.{digits}f}"
    with_t = has_scipy()
    if len(known) < (FEWEST_RUNS if with_t else FEWEST_RESAMPLED):
        return (
            f"{np.mean(known):.{digits}f} range {min(known):.{digits}f} to {max(known):.{digits}f}"
        )
    # A generator of its own: no cell depends on which others the table has.
    rng = np.random.default_rng(seed)
    mean = mean_interval(known, bounds=bounds) if with_t else estimate({"": known}, rng=rng)[""]
    return f"{mean.value:.{digits}f} [{mean.low:.{digits}f}, {mean.high:.{digits}f}]"


def _escape(text: str) -> str:
    """Plain text for LaTeX."""
    return "".join(_LATEX.get(character, character) for character in text)


_LATEX = {
    **{character: rf"\{character}" for character in "&%$#_{}"},
    **{character: f"${character}$" for character in "<>|"},
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "α": r"$\alpha$",
    "±": r"$\pm$",
    "²": r"$^2$",
    MISSING: "--",
}
