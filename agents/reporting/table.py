"""Tables of typed cells. They become text only where they are rendered."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from agents.errors import one_line
from emcc import Interval, Share

MISSING = "\N{EN DASH}"


@dataclass(frozen=True)
class Number:
    """A cell with a number, its interval and how it is written."""

    value: float | None
    """None where it is unknown, which is printed as a dash."""
    digits: int = 2
    """After the decimal point."""
    low: float | None = None
    high: float | None = None
    """Ends of the interval or of the range, where there is one."""
    is_range: bool = False
    """Whether they are the lowest and the highest run, and no interval."""
    of: int | None = None
    """The number of runs that it is a count of."""
    is_p: bool = False
    """Whether it is a p value, which is never written as 0."""
    signed: bool = False
    """Whether positive numbers have a sign too, as differences have."""
    marked: bool = False
    """Whether it stands out."""

    @property
    def text(self) -> str:
        """The number, without its interval."""
        if self.value is not None and self.of is not None:
            return f"{self.value:.0f} of {self.of}"
        return MISSING if self.value is None else self._written(self.value)

    @property
    def interval(self) -> str:
        """Its interval in brackets, or its range in words; empty without either."""
        if self.low is None or self.high is None:
            return ""
        if self.is_range:
            return f"range {self._written(self.low)} to {self._written(self.high)}"
        return f"[{self._written(self.low)}, {self._written(self.high)}]"

    def __str__(self) -> str:
        return f"{self.text} {self.interval}".rstrip()

    def _written(self, value: float) -> str:
        if self.is_p and value < (least := 10**-self.digits):
            return f"<{least:.{self.digits}f}"
        return f"{value:{'+' if self.signed else ''}.{self.digits}f}"


def number_of(
    found: Interval | None, digits: int = 2, marked: bool = False, signed: bool = False
) -> Number:
    """The cell of a mean, or of a difference, which is signed."""
    if found is None:
        return Number(None)
    ends = {"low": found.low, "high": found.high, "is_range": found.kind == "range"}
    return Number(found.value, digits, **ends, signed=signed, marked=marked)


def p_number(p: float | None) -> Number:
    """The cell of a p value."""
    return Number(p, 3, is_p=True)


def count_of(share: Share | None) -> Number:
    """The cell of a share of runs."""
    if share is None:
        return Number(None)
    return Number(share.count, low=share.low, high=share.high, of=share.runs)


Cell = str | Number


@dataclass(frozen=True)
class Row:
    """Cells of a table: a name, numbers, and where runs end."""

    name: str
    numbers: Sequence[Number]
    ends: str = ""
    kind: Literal["mean", "paper", "run", "difference", "test"] = "run"

    @property
    def cells(self) -> tuple[Cell, ...]:
        """All of them, in order."""
        return (self.name, *self.numbers, self.ends)


@dataclass(frozen=True)
class Table:
    """Rows below a head, with a caption above and notes below."""

    caption: str
    head: Sequence[str]
    rows: Sequence[Row]
    notes: Sequence[str] = ()
    marking: str = ""
    """The meaning of a mark."""

    @property
    def columns(self) -> int:
        """Those shown: the last one, where runs end, only where a run's task has places."""
        without = max((1 + len(row.numbers) for row in self.rows), default=len(self.head))
        return without + any(row.ends for row in self.rows)

    @property
    def legend(self) -> str:
        """The caption, and the meaning of a mark where there are marks."""
        marked = any(cell.marked for row in self.rows for cell in row.numbers)
        return self.caption + (f"; bold: {self.marking}" if marked and self.marking else "")

    def markdown(self) -> str:
        """The legend, the rows, and a paragraph for each note."""
        lines = [[plain(cell) for cell in self.head], ["---"] * len(self.head)]
        lines += [[_markdown(cell) for cell in row.cells] for row in self.rows]
        lines = [line[: self.columns] for line in lines]
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        padded = (
            " | ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True))
            for line in lines
        )
        notes = [part for note in self.notes for part in ("", f"Note: {plain(note)}")]
        legend = [plain(self.legend), ""] if self.legend else []
        return "\n".join([*legend, *(f"| {line} |" for line in padded), *notes, ""])


Block = Table | str
"""A part of a report: a table, or paragraphs of Markdown."""


def markdown(blocks: Iterable[Block]) -> str:
    """The parts of a report as Markdown; a legend that the table before has too stands once."""
    shown = without_repeats(blocks)
    return "\n".join(block if isinstance(block, str) else block.markdown() for block in shown)


def without_repeats(blocks: Iterable[Block]) -> Iterator[Block]:
    """The blocks, of a table whose legend is that of the table before without it."""
    before = None
    for block in blocks:
        if isinstance(block, str):
            yield block
            continue
        repeated = block.legend == before
        before = block.legend
        yield replace(block, caption="", marking="") if repeated else block


def _markdown(cell: Cell) -> str:
    if isinstance(cell, str):
        return plain(cell).replace("|", "\\|")
    if not cell.marked:
        return str(cell)
    return f"**{cell.text}** {cell.interval}".rstrip()


def plain(text: str) -> str:
    """Text that is no HTML in Markdown and no control sequence on a terminal: names come from
    other people's files."""
    return re.sub(r"<(?=[A-Za-z/!?])", "&lt;", one_line(text))
