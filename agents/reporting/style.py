"""Colour, dashes and marker of each algorithm in figures, and their SVG files."""

from __future__ import annotations

import contextlib
import gc
import io
import math
import re
from collections.abc import Collection, Iterator, Sequence
from typing import Any, NamedTuple

from agents.algorithms import ALGORITHMS
from agents.training.config import TrainConfig

# Okabe and Ito's palette, which people with any colour vision can tell apart.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#000000", "#56B4E9")
DASHES = ("-", (0, (5, 1.5)), (0, (1, 1)), (0, (6, 1.5, 1, 1.5)), (0, (3, 1, 1, 1, 1, 1)))
DASHES = (*DASHES, (0, (9, 2)), (0, (2, 2.5)), (0, (9, 1.5, 3, 1.5)))
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
"""As many as dashes: what tells colours apart without colour."""


CROWDED, PIXELS = 60, 120
"""Lines and areas of a panel beyond which they are pixels, and pixels of an inch. The page of very
many runs would have many megabytes else."""


class Style(NamedTuple):
    """How the runs of a group are drawn."""

    colour: str
    """Of the algorithm."""
    dash: Any
    """Of the algorithm; another one for each further group of it in the same figure."""
    marker: str
    """Of the algorithm, likewise."""


def styles(configs: Sequence[TrainConfig]) -> list[Style]:
    """Styles of the groups of one figure, by the place of their algorithm among all."""
    order = {name: index for index, name in enumerate(ALGORITHMS)}
    places = [order.get(config.algorithm, len(order)) for config in configs]
    taken, found = set(), []
    for k, place in enumerate(places):
        wanted = place % len(DASHES)
        if place in places[:k]:
            free = set(range(len(DASHES))) - taken - {p % len(DASHES) for p in places}
            wanted = min(free, default=wanted)
        taken.add(wanted)
        found.append(Style(COLOURS[place % len(COLOURS)], DASHES[wanted], MARKERS[wanted]))
    return found


class Legend(NamedTuple):
    """The shape of a legend below a figure."""

    columns: int
    height: float
    """Inches that the figure needs for its further lines."""


def legend(names: Collection[str]) -> Legend:
    """As wide as a figure of nine inches, at most six columns."""
    columns = min(max(1, 110 // (8 + max(map(len, names)))), 6)
    lines = math.ceil(len(names) / columns)
    return Legend(columns, 0.2 * max(lines - 2, 0))


@contextlib.contextmanager
def drawing(font_size: int = 10) -> Iterator[Any]:
    """pyplot without a display, in a style whose files are equal for equal input."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    gc.collect()  # the figure before this one is a cycle of references, of tens of megabytes
    with pyplot.rc_context({"svg.hashsalt": "circle2d", "font.size": font_size}):
        yield pyplot


def svg_of(figure: Any) -> bytes:
    """A figure of matplotlib as SVG, which is closed. Crowded panels hold their lines as pixels."""
    from matplotlib import pyplot

    for axis in figure.axes:
        if len(axis.lines) + len(axis.collections) > CROWDED:
            axis.set_rasterization_zorder(2.1)  # lines and areas, but not axes and words
    image = io.StringIO()
    figure.savefig(image, format="svg", dpi=PIXELS, metadata={"Date": None})
    pyplot.close(figure)
    # Places to a hundredth of a point: half the size, and nothing that an eye could see.
    shorter = re.sub(r' (?:d|x|y)="[^"]*"', _to_hundredths, image.getvalue())
    return shorter.encode()


def _to_hundredths(attribute: re.Match[str]) -> str:
    return re.sub(r"-?\d+\.\d{3,}", lambda x: f"{float(x.group()):.2f}", attribute.group())
