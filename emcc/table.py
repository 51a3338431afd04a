"""Tables: CSV files read into columns; cells printed as text, Markdown, CSV or LaTeX."""

import csv
import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

MISSING = "\N{EN DASH}"
FORMATS = ("text", "md", "csv", "latex")


class Columns(dict[str, list[str]]):
    """The columns of a CSV file by name, as text; blanks around cells and lines that begin with #
    are dropped.

    ValueError: not a text file, no header, two columns with the same name, or a line whose number
    of fields differs from the header's.
    """

    def __init__(self, path: Path) -> None:
        try:
            text = path.read_text(encoding="utf-8-sig")
        except UnicodeDecodeError as error:
            raise ValueError(
                f"no text at byte {error.start}: a file of costs must be a .csv in UTF-8, a .npy "
                "or a .npz, by its name"
            ) from None
        try:
            reader = csv.reader(io.StringIO(text, newline=""))
            lines = ((reader.line_num, [cell.strip() for cell in row]) for row in reader if row)
            rows = [(line, row) for line, row in lines if not row[0].startswith("#")]
        except csv.Error as error:
            raise ValueError(f"not a CSV file: {error}") from error
        if not rows:
            raise ValueError("the file is empty; a header line is needed")
        (_, header), *rows = rows
        if len(set(header)) < len(header):
            raise ValueError(f"the header names a column twice: {', '.join(header)}")
        for line, row in rows:
            if len(row) != len(header):
                raise ValueError(f"line {line}: {len(row)} fields, not {len(header)}")
        super().__init__((name, [row[k] for _, row in rows]) for k, name in enumerate(header))
        self.lines = [line for line, _ in rows]
        self.complete = text.endswith("\n")

    def numbers(self, name: str, kind: type[int] | type[float]) -> NDArray[Any]:
        """Return a column as an array. ValueError naming the line: a cell of another kind."""
        values, read = [], _whole if kind is int else float
        for line, text in zip(self.lines, self[name], strict=True):
            try:
                values.append(read(text))
            except ValueError as error:
                number = "a whole number" if kind is int else "a number"
                raise ValueError(f"line {line}, column {name}: {text!r} is not {number}") from error
        return np.array(values)  # of dtype object for integers beyond int64; callers reject these


def _whole(text: str) -> int:
    """Read a whole number; 10.0 is accepted, as pandas writes integers in a column with a NaN."""
    try:
        return int(text)
    except ValueError:
        if not (value := float(text)).is_integer():
            raise
        return int(value)


@dataclass(frozen=True)
class Table:
    """Cells of text with a caption."""

    caption: str
    head: list[str]
    rows: list[list[str]]

    def render(self, form: str) -> str:
        """Return aligned text, Markdown, CSV with the caption as a '#' comment above, or a LaTeX
        tabular with booktabs rules and the caption as a '%' comment above."""
        if form == "csv":
            body = io.StringIO()
            csv.writer(body, lineterminator="\n").writerows([self.head, *self.rows])
            return f"# {self.caption}\n{body.getvalue()}"
        if form == "latex":
            head, *rows = (
                [cell.translate(LATEX) for cell in row] for row in (self.head, *self.rows)
            )
            return tabular(self.caption, head, rows)
        lines = [self.head, *self.rows]
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        if form == "md":
            lines.insert(1, ["-" * max(3, width) for width in widths])
        padded = [
            [cell.ljust(width) for cell, width in zip(line, widths, strict=True)] for line in lines
        ]
        if form == "md":
            body = [f"| {' | '.join(line)} |" for line in padded]
        else:
            body = ["  ".join(line).rstrip() for line in padded]
        return "\n".join([self.caption, "", *body, ""])


def tabular(caption: str, head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return LaTeX cells as a tabular with booktabs rules, below the caption as a comment."""
    first, *lines = (" & ".join(row) + r" \\" for row in (head, *rows))
    top = (
        rf"\begin{{tabular}}{{@{{}}l{'r' * (len(head) - 1)}@{{}}}}",
        r"\toprule",
        first,
        r"\midrule",
    )
    return "\n".join([f"% {caption}", *top, *lines, r"\bottomrule", r"\end{tabular}", ""])


LATEX = str.maketrans(
    {character: rf"\{character}" for character in "&%$#_{}"}
    | {character: f"${character}$" for character in "<>|"}
    | {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
    | {"α": r"$\alpha$", "≤": r"$\leq$", MISSING: "--"}
)
"""Characters that LaTeX needs escaped."""
