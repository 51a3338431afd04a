"""Tables of typed cells as Markdown and as a terminal's lines; the page's template takes the same
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
"""Characters of the narrowest terminal that tables are laid out for."""
FLOAT = r"""\begin{{table}}
\centering
\caption{{{}}}
\smallskip
\resizebox{{\ifdim\width>\linewidth\linewidth\else\width\fi}}{{!}}{{%
{}}}
\end{{table}}
"""
"""A float of LaTeX: a caption above a tabular that is as wide as a line at most; needs graphicx, as
the rules need booktabs."""
LATEX_COLUMNS = ("EMCC_0.33", "EMCC_0.99", "cost rate", "J_R", "J_C")
"""Columns of tables for LaTeX, which fit the width of a text."""
NARROW, WIDE = 12, 20
"""Characters to which a terminal's columns of numbers, and those of words, are broken."""


@dataclass(frozen=True)
class Number:
    """A cell with a number, its interval and how it is written."""

    value: float | None
    """None where it is unknown, which is printed as a dash."""
    digits: int = 2
    """Digits behind the decimal point."""
    low: float | None = None
    high: float | None = None
    """Ends of the interval or of the range, where there is one."""
    is_range: bool = False
    """Whether they are the lowest and the highest run, and no interval."""
    total: int | None = None
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
        if self.value is not None and self.total is not None:
            return f"{self.value:.0f} of {self.total}"
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


def number(mean: Interval | None, digits: int = 2, signed: bool = False) -> Number:
    """The cell of a mean, or of a difference, which is signed."""
    if mean is None:
        return Number(None)
    is_range = mean.kind == "range"
    return Number(mean.value, digits, mean.low, mean.high, is_range, signed=signed)


def p_number(p: float | None) -> Number:
    """The cell of a p value."""
    return Number(p, 3, is_p=True)


def p_head(tests: int) -> str:
    """The name of p values that are corrected for so many tests by Holm's method."""
    return f"p, corrected for {tests} (Holm)" if tests > 1 else "p"


def corrected(tests: int, where: str) -> str:
    """The correction in words, behind the name of a test; empty for a test alone."""
    return f", corrected for the {tests} comparisons {where} (Holm)" if tests > 1 else ""


def count(share: Share | None) -> Number:
    """The cell of a share of runs."""
    if share is None:
        return Number(None)
    return Number(share.count, low=share.low, high=share.high, total=share.runs)


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
    details: Collection[str] = ()
    """Heads of columns that a terminal leaves out."""
    in_paper: str = ""
    """The caption in LaTeX, which has no runs and fewer columns; by default the legend."""

    @property
    def columns(self) -> int:
        """Columns shown: the last one, where runs end, only where a run's task has places."""
        without = max((1 + len(row.numbers) for row in self.rows), default=len(self.head))
        return without + any(row.ends for row in self.rows)

    @property
    def legend(self) -> str:
        """The caption, and the meaning of a mark where there are marks."""
        marked = any(cell.marked for row in self.rows for cell in row.numbers)
        return self.caption + (f"; bold: {self.marking}" if marked and self.marking else "")

    def brief(self) -> Table:
        """The means without intervals, details, legend and notes, a number of runs that all have in
        common in the head; all rows of a table without means."""
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
        """The legend, the rows, and a paragraph for each note."""
        head, rows = map(plain, self.head), (map(_markdown, row.cells) for row in self.rows)
        head, *rows = (list(cells)[: self.columns] for cells in (head, *rows))
        notes = [part for note in self.notes for part in ("", f"Note: {plain(note)}")]
        legend = [plain(self.legend), ""] if self.legend else []
        return "\n".join([*legend, markdown_rows(head, rows), *notes, ""])

    def latex(self, columns: Collection[str] = LATEX_COLUMNS) -> str:
        """The means above their intervals, and the paper's numbers, as a table with a caption and
        the rules of booktabs; all rows of a table without means. Legend and notes are comments.

        columns: heads of those shown beside the name; of a table that has none of them all but the
        details.
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
"""Intervals in words."""
_SIZE = re.compile(r", mean of (\d+)$")
"""The number of runs, at the end of a mean's name."""
Block = Table | str
"""A part of a report: a table, or paragraphs of Markdown."""


def markdown(blocks: Iterable[Block]) -> str:
    """The parts of a report as Markdown; a legend that the table before has too stands once."""
    shown = without_repeats(blocks)
    return "\n".join(block if isinstance(block, str) else block.markdown() for block in shown)


def latex(tables: Mapping[str, Table], columns: Collection[str] = LATEX_COLUMNS) -> str:
    """Tables for LaTeX, each below its name as a comment; columns: see `Table.latex`. Raises
    UserError for a column that none of them has."""
    heads = dict.fromkeys(head for table in tables.values() for head in table.head[1:])
    for column in columns:
        if columns != LATEX_COLUMNS and column not in heads:
            raise UserError(f"no table has a column {column!r}: {nearest(column, heads)}")
    named = (f"% {one_line(n)}\n{table.latex(columns)}" for n, table in tables.items())
    return "\n".join(["% \\usepackage{booktabs,graphicx}", *named])


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


def plain(text: str) -> str:
    """Text that is no HTML in Markdown and no control sequence on a terminal: names come from
    other people's files."""
    return re.sub(r"<(?=[A-Za-z/!?])", "&lt;", one_line(text))


def markdown_rows(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Cells of Markdown as a table, without a newline at its end."""
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
    """A cell of LaTeX, a number without its interval."""
    if isinstance(cell, str):
        return one_line(cell).translate(LATEX)
    text = _minus(cell.text)
    return rf"\textbf{{{text}}}" if cell.marked else text


def _latex_symbol(head: str) -> str:
    """The head of a column; J_R and EMCC_0.33 have their index below the line, as in a text."""
    symbol = re.fullmatch(r"([A-Za-z]+)_([A-Z]|[\d.]+)", head)
    if symbol is None:
        return _latex(head)
    stem, index = symbol.groups()
    return rf"${stem}_{{{index}}}$" if len(stem) == 1 else rf"{stem}$_{{{index}}}$"


def _latex_words(text: str) -> str:
    """Sentences, with the symbols of columns in them."""
    symbol = r"\b([A-Za-z]+_(?:[A-Z]\b|\d\.\d+))"
    parts = re.split(symbol, one_line(text))  # in turn words and symbols
    return "".join(_latex_symbol(part) if k % 2 else _latex(part) for k, part in enumerate(parts))


def _latex_interval(cell: Cell) -> str:
    """The interval below a number in brackets, or its range in parentheses; empty without."""
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
    """Print the blocks of a report: laid out on a terminal, or where a width is given; as Markdown
    into a file or a pipe, for programs.

    width: characters of a line, by default the terminal's. more: place of the whole tables, where
    a terminal is to have the means alone.
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
    """Show on a terminal that work goes on whose end cannot be foreseen."""
    from rich.console import Console

    return Console(stderr=True).status(on)


def _laid_out(block: Block, width: int) -> Iterator[Any]:
    """Paragraphs, and the parts of a table that fit the width."""
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
    """Cells as `rich.text.Text`, the head first."""
    width: int
    """Characters of a line, in which every word has room."""


def parts(table: Table, width: int) -> list[list[Column]]:
    """Divide the columns of a table so that each part fits the width; every part begins with the
    first column. A column that alone is wider than the width gets a part of its own."""
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
    """The name of a row; of one that is too long what follows the last comma has its own line."""
    first, comma, last = name.rpartition(", ")
    return name if len(name) <= width or not comma else f"{first},\n{last}"


def _column(cells: Sequence[Cell], most: int) -> Column:
    """A column of at most so many characters, unless a word is longer. Intervals stand below their
    number."""
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
