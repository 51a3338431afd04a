"""CSV text -> named columns of text -> arrays; a damaged cell is named by file, line and column."""

import csv
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray


def read_columns(path: Path) -> dict[str, list[str]]:
    """The columns of a CSV file by their names, still as text.

    ValueError: not a text file, no header, or a line with another number of fields than the header.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.reader(file))
    except (UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"{path}: not a CSV file: {error}") from None
    if not rows:
        raise ValueError(f"{path}: the file is empty; a header line is needed")
    header = rows.pop(0)
    for line, row in enumerate(rows, start=2):
        if len(row) != len(header):
            raise ValueError(
                f"{path}, line {line}: {len(row)} fields, the header has {len(header)}"
            )
    return {name: [row[index] for row in rows] for index, name in enumerate(header)}


def parse(
    path: Path, columns: dict[str, list[str]], name: str, number: type[int] | type[float]
) -> NDArray[Any]:
    """One column as an array of `number` (int or float).

    ValueError: a cell that is no such number.
    """
    values = []
    for line, text in enumerate(columns[name], start=2):
        try:
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
