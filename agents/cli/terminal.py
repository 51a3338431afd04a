"""A report on a terminal: tables that fit its width, in several parts where one would not."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from rich import box
from rich.console import Console
from rich.markdown import Markdown
from rich.table import Table as Grid
from rich.text import Text

from agents.cli.checks import LEAST_WIDTH
from agents.reporting.table import Block, Cell, Table, markdown, plain, without_repeats

Column = list[Text]
HEAD, WORDS = 12, 20
"""Characters to which a column's head and the intervals in it, and its words, are broken."""
_GAP = 3
"""Characters between columns."""


def show(blocks: Sequence[Block], width: int | None = None) -> None:
    """Print the blocks of a report: laid out on a terminal, or where a width is given; as Markdown
    into a file or a pipe, for programs.

    width: characters of a line, by default the terminal's.
    """
    console = Console(highlight=False, width=width)
    if width is None and not console.is_terminal:
        print(markdown(blocks))
        return
    for block in without_repeats(blocks):
        for shown in _laid_out(block, max(console.width, LEAST_WIDTH)):
            console.print(shown)
            console.print()


def _laid_out(block: Block, width: int) -> Iterator[Markdown | Grid]:
    """Paragraphs and the parts of tables."""
    if isinstance(block, str):
        yield from map(Markdown, re.split(r"\n\s*\n", block.strip()))
        return
    if block.legend:
        yield Markdown(plain(block.legend))
    yield from map(_grid, parts(block, width))
    yield from (Markdown(f"Note: {plain(note)}") for note in block.notes)


def parts(table: Table, width: int) -> list[list[Column]]:
    """Divide the columns of a table so that each part fits the width; every part begins with the
    first column, and cells have line breaks where they may break.

    A column that alone is wider than the width gets a part of its own. A column begins with its
    head.
    """
    names = [
        Text(_name(plain(name), max(width // 3, 16)))
        for name in (table.head[0], *(row.name for row in table.rows))
    ]
    found, used = [[names]], _width(names)
    columns = zip(table.head, *(row.cells for row in table.rows), strict=False)
    for head, *cells in list(columns)[1 : table.columns]:
        column = [Text(_broken(plain(head), HEAD)), *map(_cell, cells)]
        more = _GAP + _width(column)
        if used + more > width and len(found[-1]) > 1:
            found.append([names])
            used = _width(names)
        found[-1].append(column)
        used += more
    return found


def _name(name: str, width: int) -> str:
    """The name of a row; where it is too long, what follows the last comma has its own line."""
    first, comma, last = name.rpartition(", ")
    if len(name) <= width or not comma:
        return _broken(name, width)
    return f"{_broken(first + ',', width)}\n{_broken(last, width)}"


def _cell(cell: Cell) -> Text:
    """A number or a count above its interval; words in lines of some width."""
    if isinstance(cell, str):
        return Text(_broken(plain(cell), WORDS))
    lines = filter(None, (cell.text, _broken(cell.interval, HEAD)))
    return Text("\n".join(lines), "bold" if cell.marked else "")


def _broken(cell: str, width: int) -> str:
    """A cell in lines of at most the width, where words allow it; brackets stay together."""
    lines: list[str] = []
    for word in re.findall(r"(?:\[[^\]]*\]|\([^)]*\)|\S)+", cell):
        joined = f"{lines[-1]} {word}" if lines else word
        if lines and len(joined) <= width:
            lines[-1] = joined
        else:
            lines.append(word)
    return "\n".join(lines)


def _width(column: Column) -> int:
    return max(len(line) for cell in column for line in cell.plain.split("\n"))


def _grid(columns: Sequence[Column]) -> Grid:
    grid = Grid(box=box.SIMPLE_HEAD, padding=(0, _GAP - 1, 0, 0), pad_edge=False, show_edge=False)
    for place, (head, *_) in enumerate(columns):
        grid.add_column(head, justify="right" if place else "left", no_wrap=True)
    for row in list(zip(*columns, strict=True))[1:]:
        grid.add_row(*row)
    return grid
