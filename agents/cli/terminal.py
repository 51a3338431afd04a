"""Markdown on a terminal: tables that fit its width, in several parts where one would not."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from rich import box
from rich.console import Console
from rich.markdown import Markdown
from rich.table import Table
from rich.text import Text

from agents.cli.checks import LEAST_WIDTH

Rows = list[list[str]]
HEAD, WORDS = 12, 20
"""Characters to which a column's head and the intervals in it, and its words, are broken."""
_GAP = 3
"""Characters between columns."""


def show(markdown: str, width: int | None = None) -> None:
    """Print Markdown: laid out on a terminal, or where a width is given; as it is into a file or a
    pipe, for programs.

    width: characters of a line, by default the terminal's.
    """
    console = Console(highlight=False, width=width)
    if width is None and not console.is_terminal:
        print(markdown)
        return
    for block in _blocks(markdown):
        if isinstance(block, str):
            console.print(Markdown(block))
            console.print()
            continue
        for part in parts(block, max(console.width, LEAST_WIDTH)):
            console.print(_table(part))
            console.print()


def _blocks(markdown: str) -> Iterator[str | Rows]:
    """Paragraphs, as text, and the cells of tables, the head first."""
    text: list[str] = []
    rows: Rows = []
    for line in [*markdown.splitlines(), ""]:
        if line.startswith("|"):
            rows.append([cell.strip() for cell in re.split(r"(?<!\\)\|", line.strip().strip("|"))])
        elif line.strip():
            text.append(line)
        if rows and not line.startswith("|"):
            yield [row for row in rows if set("".join(row)) - set(":- ")]
            rows = []
        if text and (not line.strip() or line.startswith("|")):
            yield "\n".join(text)
            text = []


def parts(rows: Rows, width: int) -> list[Rows]:
    """Divide the columns of a table so that each part fits the width; every part begins with the
    first column, and cells have line breaks where they may break.

    A column that alone is wider than the width gets a part of its own.
    """
    columns = [list(column) for column in zip(*rows, strict=True)]
    names = [_name(name, max(width // 3, 16)) for name in columns[0]]
    found, used = [[names]], _width(names)
    for column in columns[1:]:
        cells = [_broken(column[0], HEAD), *map(_cell, column[1:])]
        more = _GAP + _width(cells)
        if used + more > width and len(found[-1]) > 1:
            found.append([names])
            used = _width(names)
        found[-1].append(cells)
        used += more
    return [[list(row) for row in zip(*part, strict=True)] for part in found]


def _name(name: str, width: int) -> str:
    """The name of a row; where it is too long, what follows the last comma has its own line."""
    first, comma, last = name.rpartition(", ")
    if len(_plain(name)) <= width or not comma:
        return _broken(name, width)
    return f"{_broken(first + ',', width)}\n{_broken(last, width)}"


def _cell(cell: str) -> str:
    """A number or a count above what follows it, its interval; words in lines of some width."""
    found = re.fullmatch(r"([-+<\d.*]+(?: of \d+)?) (?!of )(.+)", cell)
    return f"{found[1]}\n{_broken(found[2], HEAD)}" if found else _broken(cell, WORDS)


def _broken(cell: str, width: int) -> str:
    """A cell in lines of at most the width, where words allow it; brackets stay together."""
    lines: list[str] = []
    for word in re.findall(r"(?:\[[^\]]*\]|\([^)]*\)|\S)+", cell):
        joined = f"{lines[-1]} {word}" if lines else word
        if lines and len(_plain(joined)) <= width:
            lines[-1] = joined
        else:
            lines.append(word)
    return "\n".join(lines)


def _width(cells: Sequence[str]) -> int:
    return max((len(_plain(line)) for cell in cells for line in cell.split("\n")), default=0)


def _plain(text: str) -> str:
    return text.replace("**", "")


def _table(rows: Rows) -> Table:
    table = Table(box=box.SIMPLE_HEAD, padding=(0, _GAP - 1, 0, 0), pad_edge=False, show_edge=False)
    for place, head in enumerate(rows[0]):
        table.add_column(head, justify="right" if place else "left", no_wrap=True)
    for row in rows[1:]:
        styles = ["bold" if "**" in cell else "" for cell in row]
        table.add_row(*(Text(_plain(c), style) for c, style in zip(row, styles, strict=True)))
    return table
