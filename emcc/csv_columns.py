"""CSV text -> named columns of text -> arrays; a damaged cell is named by file, line and column."""

import csv
import io
from collections import Counter
from itertools import dropwhile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray


class Columns(dict[str, list[str]]):
    """The columns of a CSV file by their names, still as text."""

    path: Path
    lines: list[int]
    """Number of the line of each row."""


def read_columns(path: Path, data: bytes | None = None) -> Columns:
    """The columns of a CSV file. Empty lines are skipped, and those above the header that begin
    with '#'. Blanks around names and cells do not count.

    data: its content, where that was read already.
    ValueError: not a text file, no header, two columns of one name, or a line with another number
    of fields than the header.
    """
    try:
        text = (path.read_bytes() if data is None else data).decode("utf-8-sig")
        reader = csv.reader(io.StringIO(text, newline=""))
        rows = [(reader.line_num, row) for row in reader if row]
    except (UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"{path}: not a CSV file: {error}") from None
    rows = list(dropwhile(lambda numbered: numbered[1][0].startswith("#"), rows))
    if not rows:
        raise ValueError(f"{path}: the file is empty; a header line is needed")
    header, rows = [name.strip() for name in rows[0][1]], rows[1:]
    repeated = [name for name, times in Counter(header).items() if name and times > 1]
    if repeated:
        raise ValueError(f"{path}: the header names {', '.join(repeated)} more than once")
    for line, row in rows:
        if len(row) != len(header):
            raise ValueError(
                f"{path}, line {line}: {len(row)} fields, the header has {len(header)}"
            )
    columns = Columns(
        (name, [row[index].strip() for _, row in rows]) for index, name in enumerate(header)
    )
    columns.path, columns.lines = path, [line for line, _ in rows]
    return columns


def parse(columns: Columns, name: str, number: type[int] | type[float]) -> NDArray[Any]:
    """One column as an array of `number` (int or float).

    ValueError: a cell that is no such number.
    """
    path, values = columns.path, []
    for line, text in zip(columns.lines, columns[name], strict=True):
        try:
            if not text.isascii() or "_" in text:  # Python reads 1_0 and the digits of any script
                raise ValueError
            values.append(number(text))
        except ValueError:
            raise ValueError(
                f"{path}, line {line}, column {name}: {text!r} is not {_WORDS[number]}"
            ) from None
    try:
        return np.array(values, dtype=number)
    except OverflowError:
        raise ValueError(f"{path}, column {name}: a number is too large") from None


_WORDS = {int: "a whole number", float: "a number"}


class BadRow(ValueError):
    """A row, from 0 on, whose values cannot be."""

    def __init__(self, row: int, problem: str) -> None:
        super().__init__(f"row {row}, {problem}")
        self.row, self.problem = row, problem
