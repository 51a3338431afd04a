"""Tables of text: CSV files read into columns; cells printed as text, Markdown, CSV or LaTeX."""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

MISSING = "\N{EN DASH}"
FORMATS = ("text", "md", "csv", "latex")


class Columns(dict[str, list[str]]):
    """The columns of a CSV file by their names, still as text; blanks around cells are dropped.

    ValueError: not a text file, no header, two columns of one name, or a line with another number
    of fields than the header.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            text = path.read_text(encoding="utf-8-sig")
            reader = csv.reader(io.StringIO(text, newline=""))
            rows = [(reader.line_num, [cell.strip() for cell in row]) for row in reader if row]
        except (UnicodeDecodeError, csv.Error) as error:
            raise ValueError(f"{path}: not a CSV file: {error}") from error
        if not rows:
            raise ValueError(f"{path}: the file is empty; a header line is needed")
        (_, header), *rows = rows
        if len(set(header)) < len(header):
            raise ValueError(f"{path}: the header names a column twice: {', '.join(header)}")
        for line, row in rows:
            if len(row) != len(header):
                raise ValueError(f"{path}, line {line}: {len(row)} fields, not {len(header)}")
        super().__init__((name, [row[k] for _, row in rows]) for k, name in enumerate(header))
        self.lines = [line for line, _ in rows]
        self.complete = text.endswith("\n")

    def numbers(self, name: str, kind: type[int] | type[float]) -> NDArray[Any]:
        """One column as an array. ValueError: a cell that is no such number, by its line."""
        values = []
        for line, text in zip(self.lines, self[name], strict=True):
            try:
                if not text.isascii() or "_" in text:  # Python reads 1_0 and digits of any script
                    raise ValueError("not a plain number")
                values.append(kind(text))
            except ValueError as error:
                number = "a whole number" if kind is int else "a number"
                place = f"{self.path}, line {line}, column {name}"
                raise ValueError(f"{place}: {text!r} is not {number}") from error
        try:
            return np.array(values, dtype=kind)
        except OverflowError as error:
            raise ValueError(f"{self.path}, column {name}: a number is too large") from error


@dataclass(frozen=True)
class Table:
    """Cells of text, with a caption above and notes below them."""

    caption: str
    head: list[str]
    rows: list[list[str]]
    notes: Sequence[str] = ()

    def render(self, form: str) -> str:
        """Lines of aligned text, Markdown, CSV whose comment lines begin with '#', or LaTeX's
        tabular with the rules of booktabs, whose comment lines begin with '%'."""
        if form == "csv":
            body = io.StringIO()
            csv.writer(body, lineterminator="\n").writerows([self.head, *self.rows])
            return "".join(f"# {line}\n" for line in (self.caption, *self.notes)) + body.getvalue()
        if form == "latex":
            comments = [f"% {line}" for line in (self.caption, *self.notes)]
            escaped = ([cell.translate(LATEX) for cell in row] for row in (self.head, *self.rows))
            rows = [" & ".join(row) + r" \\" for row in escaped]
            top = (rf"\begin{{tabular}}{{l{'r' * (len(self.head) - 1)}}}", r"\toprule", rows[0])
            end = (r"\bottomrule", r"\end{tabular}", "")
            return "\n".join([*comments, *top, r"\midrule", *rows[1:], *end])
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
        notes = [text for note in self.notes for text in ("", note)]  # a paragraph each
        return "\n".join([self.caption, "", *body, *notes, ""])


LATEX = str.maketrans(
    {character: rf"\{character}" for character in "&%$#_{}"}
    | {character: f"${character}$" for character in "<>|"}
    | {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
    | {"α": r"$\alpha$", MISSING: "--"}
)
"""Characters that are written otherwise in LaTeX."""
