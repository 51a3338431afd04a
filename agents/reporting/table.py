"""Tables of typed cells, as Markdown, LaTeX and terminal output; the page's template uses the same
cells."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

from agents.errors import UserError, nearest, one_line
from emcc import Interval, Share
from emcc.table import LATEX, tabular

MISSING = "\N{EN DASH}"
LEAST_WIDTH = 40
"""Narrowest terminal, in characters, for which tables are laid out."""
FLOAT = r"""\begin{{table}}
\centering
\caption{{{}}}
\smallskip
\resizebox{{\ifdim\width>\linewidth\linewidth\else\width\fi}}{{!}}{{%
{}}}
\end{{table}}
"""
"""LaTeX float: a caption above a tabular scaled down to the line width. It needs graphicx, and the
tabular's rules need booktabs."""
LATEX_COLUMNS = ("EMCC_0.33", "EMCC_0.99", "cost rate", "J_R", "J_C")
"""Default columns of LaTeX tables, which fit the width of a text."""
NARROW, WIDE = 12, 20
"""Characters at which a terminal's columns of numbers, and of words, are wrapped."""


@dataclass(frozen=True)
class Number:
    """A cell with a number, its interval and its format."""

    value: float | None
    """None if unknown, printed as a dash."""
    digits: int = 2
    """Digits after the decimal point."""
    low: float | None = None
    high: float | None = None
    """Ends of the interval or range, if there is one."""
    is_range: bool = False
    """Whether `low` and `high` are the lowest and highest run instead of an interval."""
    total: int | None = None
    """For a count of runs: the number of all runs."""
    is_p: bool = False
    """Whether the number is a p value, which is never written as 0."""
    signed: bool = False
    """Whether positive numbers are written with a sign, as in differences."""
    marked: bool = False
    """Whether the number is printed in bold."""

    @property
    def text(self) -> str:
        """The number without its interval."""
        if self.value is not None and self.total is not None:
            return f"{self.value:.0f} of {self.total}"
        return MISSING if self.value is None else self._written(self.value)

    @property
    def interval(self) -> str:
        """The interval in brackets, or the range in words; empty without either."""
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


def number(mean: Interval | None, digits: int = 2, signed: bool = False) -> Number:
    """Return the cell of a mean; signed: of a difference."""
    if mean is None:
        return Number(None)
    is_range = mean.kind == "range"
    return Number(mean.value, digits, mean.low, mean.high, is_range, signed=signed)


def p_number(p: float | None) -> Number:
    """Return the cell of a p value."""
    return Number(p, 3, is_p=True)


def p_head(tests: int) -> str:
    """Return the heading of p values that are corrected for `tests` tests by Holm's method."""
    return f"p, corrected for {tests} (Holm)" if tests > 1 else "p"


def corrected(tests: int, where: str) -> str:
    """Return the correction in words, to follow a test's name; empty for a single test."""
    return f", corrected for the {tests} comparisons {where} (Holm)" if tests > 1 else ""


def count(share: Share | None) -> Number:
    """Return the cell of a share of runs: a count with its interval."""
    if share is None:
        return Number(None)
    return Number(share.count, low=share.low, high=share.high, total=share.runs)


Cell = str | Number


@dataclass(frozen=True)
class Row:
    """A row of a table: a name, numbers, and where runs end."""

    name: str
    numbers: Sequence[Number]
    ends: str = ""
    kind: Literal["mean", "paper", "run", "difference", "test"] = "run"

    @property
    def cells(self) -> tuple[Cell, ...]:
        """All cells in order."""
        return (self.name, *self.numbers, self.ends)


@dataclass(frozen=True)
class Table:
    """Rows below a heading, with a caption above and notes below."""

    caption: str
    head: Sequence[str]
    rows: Sequence[Row]
    notes: Sequence[str] = ()
    marking: str = ""
    """Meaning of a mark, which is bold."""
    details: Collection[str] = ()
    """Headings of columns that a terminal leaves out."""
    in_paper: str = ""
    """Caption in LaTeX, where the table has no runs and fewer columns; by default `caption`."""

    @property
    def columns(self) -> int:
        """Number of columns shown; the last one, where runs end, needs a task with places."""
        without = max((1 + len(row.numbers) for row in self.rows), default=len(self.head))
        return without + any(row.ends for row in self.rows)

    @property
    def legend(self) -> str:
        """The caption and, if some cell is marked, what marks mean."""
        marked = any(cell.marked for row in self.rows for cell in row.numbers)
        return self.caption + (f"; bold: {self.marking}" if marked and self.marking else "")

    def brief(self) -> Table:
        """Return a short table: means without intervals, details, legend and notes.

        A number of runs that all means share moves to the heading. A table without means keeps all
        its rows."""
        found = [_SIZE.search(row.name) for row in self.rows if row.kind == "mean"]
        sizes = {size and size[1] for size in found}
        common = sizes.pop() if len(sizes) == 1 else None
        rows = []
        for row in [r for r in self.rows if r.kind in ("mean", "paper")] or self.rows:
            shown = zip(self.head[1:], row.numbers, strict=False)
            numbers = [replace(n, low=None, high=None) for h, n in shown if h not in self.details]
            name = _SIZE.sub("" if common else r", n = \1", row.name)
            ends = _INTERVAL.sub("", row.ends)
            rows.append(replace(row, name=name, numbers=numbers, ends=ends))
        first, *others = [head for head in self.head if head not in self.details]
        return Table("", [first + (f", n = {common}" if common else ""), *others], rows)

    def markdown(self) -> str:
        """Return Markdown: the legend, the rows, and a paragraph for each note."""
        head, rows = map(plain, self.head), (map(_markdown, row.cells) for row in self.rows)
        head, *rows = (list(cells)[: self.columns] for cells in (head, *rows))
        notes = [part for note in self.notes for part in ("", f"Note: {plain(note)}")]
        legend = [plain(self.legend), ""] if self.legend else []
        return "\n".join([*legend, markdown_rows(head, rows), *notes, ""])

    def latex(self, columns: Collection[str] = LATEX_COLUMNS) -> str:
        """Return LaTeX: means above their intervals, and published numbers, with a caption and the
        rules of booktabs. A table without means keeps all rows. Legend and notes are comments.

        columns: headings of the columns to show after the name. A table with none of these shows
        all columns but the details.
        """
        rows = [row for row in self.rows if row.kind in ("mean", "paper")] or self.rows
        shown = [k for k, head in enumerate(self.head[: self.columns]) if k and head in columns]
        if not shown:
            shown = [k for k in range(1, self.columns) if self.head[k] not in self.details]
        lines = []
        for row in rows:
            name, *more = re.split(r" (?=\()|, ", row.name, maxsplit=1)
            cells = [row.cells[k] for k in shown]
            below = [_small("".join(more)), *map(_latex_interval, cells)]
            lines += [[_latex(name), *map(_latex, cells)], *[below] * any(below)]
        head = [_latex(self.head[0]), *(_latex_symbol(self.head[k]) for k in shown)]
        numbers = [cell for row in rows for k in shown if isinstance(cell := row.cells[k], Number)]
        words = [self.in_paper or self.caption]
        if any(cell.is_range for cell in numbers) and not self.in_paper:
            words.append("(lowest, highest run)")
        if any(cell.marked for cell in numbers) and self.marking:
            words.append(f"bold: {self.marking}")
        said = "; ".join(filter(None, words))
        said = _latex_words(said[:1].upper() + said[1:] + "." * bool(said))
        notes = [f"% Note: {one_line(note)}\n" for note in self.notes]
        grid = tabular(one_line(self.legend), head, lines)
        return FLOAT.format(said, grid) + "".join(notes)


_INTERVAL = re.compile(r" \[[^\]]*\]")
"""Intervals in a row's last cell, where runs end."""
_SIZE = re.compile(r", mean of (\d+)$")
"""The number of runs, at the end of a mean's name."""
Block = Table | str
"""A part of a report: a table, or paragraphs of Markdown."""


def markdown(blocks: Iterable[Block]) -> str:
    """Return a report's blocks as Markdown, without legends that repeat the previous table's."""
    shown = without_repeats(blocks)
    return "\n".join(block if isinstance(block, str) else block.markdown() for block in shown)


def latex(tables: Mapping[str, Table], columns: Collection[str] = LATEX_COLUMNS) -> str:
    """Return tables as LaTeX, each below its name as a comment; columns: see `Table.latex`. Raises
    UserError for a column that no table has."""
    heads = dict.fromkeys(head for table in tables.values() for head in table.head[1:])
    for column in columns:
        if columns != LATEX_COLUMNS and column not in heads:
            raise UserError(f"no table has a column {column!r}: {nearest(column, heads)}")
    named = (f"% {one_line(n)}\n{table.latex(columns)}" for n, table in tables.items())
    return "\n".join(["% \\usepackage{booktabs,graphicx}", *named])


def without_repeats(blocks: Iterable[Block]) -> Iterator[Block]:
    """Yield the blocks, without the legend of a table if it repeats the previous table's."""
    before = None
    for block in blocks:
        if isinstance(block, str):
            yield block
            continue
        repeated = block.legend == before
        before = block.legend
        yield replace(block, caption="", marking="") if repeated else block


def plain(text: str) -> str:
    """Escape text for Markdown and terminals. Names come from other people's files, so HTML and
    control sequences are neutralised."""
    return re.sub(r"<(?=[A-Za-z/!?])", "&lt;", one_line(text))


def markdown_rows(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Lay out cells of Markdown as a table, without a final newline."""
    lines = [head, ["---"] * len(head), *rows]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    padded = ([*map(str.ljust, line, widths)] for line in lines)
    return "\n".join(f"| {' | '.join(line)} |" for line in padded)


def _markdown(cell: Cell) -> str:
    if isinstance(cell, str):
        return plain(cell).replace("|", "\\|")
    if not cell.marked:
        return str(cell)
    return f"**{cell.text}** {cell.interval}".rstrip()


def _latex(cell: Cell) -> str:
    """Return a cell as LaTeX, without the interval of a number."""
    if isinstance(cell, str):
        return one_line(cell).translate(LATEX)
    text = _minus(cell.text)
    return rf"\textbf{{{text}}}" if cell.marked else text


def _latex_symbol(head: str) -> str:
    """Return a column's heading as LaTeX, where J_R and EMCC_0.33 have subscripts."""
    symbol = re.fullmatch(r"([A-Za-z]+)_([A-Z]|[\d.]+)", head)
    if symbol is None:
        return _latex(head)
    stem, index = symbol.groups()
    return rf"${stem}_{{{index}}}$" if len(stem) == 1 else rf"{stem}$_{{{index}}}$"


def _latex_words(text: str) -> str:
    """Return sentences as LaTeX, with columns' names in them as symbols."""
    symbol = r"\b([A-Za-z]+_(?:[A-Z]\b|\d\.\d+))"
    parts = re.split(symbol, one_line(text))  # alternating words and symbols
    return "".join(_latex_symbol(part) if k % 2 else _latex(part) for k, part in enumerate(parts))


def _latex_interval(cell: Cell) -> str:
    """Return a cell's interval in brackets, or its range in parentheses; empty without either."""
    if isinstance(cell, str) or not cell.interval:
        return ""
    words = cell.interval
    if cell.is_range:
        words = f"({words.removeprefix('range ').replace(' to ', ', ')})"
    return _small(words)


def _small(words: str) -> str:
    return rf"{{\scriptsize {_minus(words)}}}" if words else ""


def _minus(words: str) -> str:
    return re.sub(r"-(?=\d)", "$-$", words.translate(LATEX))


def show(blocks: Sequence[Block], width: int | None = None, more: str = "") -> None:
    """Print the blocks of a report: laid out for a terminal or a given width, otherwise, to a file
    or pipe, as Markdown.

    width: characters of a line, by default the terminal's. more: where the full tables are; if
    given, a terminal shows only the means.
    """
    from rich.console import Console

    console = Console(highlight=False, width=width)
    if width is None and not console.is_terminal:
        print(markdown(blocks))
        return
    if more:
        ending = f"Means over seeds; intervals, single runs and definitions: {plain(more)}"
        blocks = [*(b if isinstance(b, str) else b.brief() for b in blocks), ending]
    for block in without_repeats(blocks):
        for shown in _laid_out(block, max(console.width, LEAST_WIDTH)):
            console.print(shown)
            console.print()


def working(on: str) -> contextlib.AbstractContextManager[object]:
    """Show a spinner on a terminal, for work of unknown duration."""
    from rich.console import Console

    return Console(stderr=True).status(on)


def _laid_out(block: Block, width: int) -> Iterator[Any]:
    """Yield what `rich` prints: paragraphs, and the parts of a table that fit the width."""
    from rich import box
    from rich.markdown import Markdown
    from rich.table import Table as Grid

    if isinstance(block, str):
        yield from map(Markdown, re.split(r"\n\s*\n", block.strip()))
        return
    if block.legend:
        yield Markdown(plain(block.legend))
    for part in parts(block, width):
        grid = Grid(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False, show_edge=False)
        for place, column in enumerate(part):
            justify = "right" if place else "left"
            grid.add_column(column.cells[0], width=column.width, justify=justify)
        for row in list(zip(*(column.cells for column in part), strict=True))[1:]:
            grid.add_row(*row)
        yield grid
    yield from (Markdown(f"Note: {plain(note)}") for note in block.notes)


class Column(NamedTuple):
    """A column of a terminal's table."""

    cells: list[Any]
    """Cells as `rich.text.Text`, the heading first."""
    width: int
    """Width in characters; every word fits."""


def parts(table: Table, width: int) -> list[list[Column]]:
    """Divide a table's columns into parts that fit the width; each begins with the first column.
    A column wider than the whole width gets a part of its own."""
    most = max(width * 2 // 5, 16)
    first = (table.head[0], *(row.name for row in table.rows))
    names = _column([_name(plain(name), most) for name in first], most)
    divided, used = [[names]], names.width
    columns = list(zip(table.head, *(row.cells for row in table.rows), strict=False))
    for cells in columns[1 : table.columns]:
        words = any(isinstance(cell, str) and cell for cell in cells[1:])
        shown = [plain(cell) if isinstance(cell, str) else cell for cell in cells]
        column = _column(shown, WIDE if words else NARROW)
        more = 2 + column.width  # and the gap
        if used + more > width and len(divided[-1]) > 1:
            divided.append([names])
            used = names.width
        divided[-1].append(column)
        used += more
    return divided


def _name(name: str, width: int) -> str:
    """Return a row's name; if it is too long, what follows its last comma is on a second line."""
    first, comma, last = name.rpartition(", ")
    return name if len(name) <= width or not comma else f"{first},\n{last}"


def _column(cells: Sequence[Cell], most: int) -> Column:
    """Lay out a column in at most `most` characters, unless a word is longer. Intervals are printed
    below their number."""
    from rich.text import Text

    lines = [
        cell if isinstance(cell, str) else f"{cell.text}\n{cell.interval}".rstrip()
        for cell in cells
    ]
    word = max(len(word) for line in lines for word in line.split() or [""])
    longest = max(len(line) for text in lines for line in text.split("\n"))
    bold = [not isinstance(cell, str) and cell.marked for cell in cells]
    shown = [Text(line, "bold" if b else "") for line, b in zip(lines, bold, strict=True)]
    return Column(shown, min(longest, max(word, most)))
