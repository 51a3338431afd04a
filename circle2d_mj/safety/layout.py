"""Layouts: places for an agent and its objects, by rejection sampling."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from circle2d_mj.core.streams import Streams

Floats = NDArray[np.float64]

OBJECT_TRIES, LAYOUT_TRIES, GOAL_TRIES = 100, 10_000, 10_000
_AT_ONCE = 32  # attempts made at once after the first has failed
_BLOCK = 10  # points tried at first; more are seldom needed


class ResamplingError(RuntimeError):
    """Raised if no layout is found; the name is safety-gymnasium's."""


class Areas(NamedTuple):
    """Where each of k objects may be placed, in the order of placement."""

    centre: Floats
    """[k, 2] m, centres of the rectangles in which objects' centres are placed."""
    half: Floats
    """[k, 2] m, half-widths of these rectangles."""
    keepout: Floats
    """[k] m; the distance of two objects is at least the sum of their keepouts."""


def sample_layout(
    streams: Streams,
    index: NDArray[np.intp],
    areas: Areas,
    layout_tries: int = LAYOUT_TRIES,
) -> Floats:
    """Draw a place for each object of the environments `index`: [len(index), objects, 2] m.

    Objects are placed one after another: each is drawn uniformly from its rectangle until it is far
    enough from the previous ones. If 100 draws of an object fail, the environment starts over.
    Raises ResamplingError if `layout_tries` attempts, or up to 31 more, have failed.
    """
    layout, complete = _attempt(streams, index, areas)
    waiting, attempts = np.flatnonzero(~complete), 1
    while len(waiting):
        if attempts >= layout_tries:
            raise ResamplingError(
                f"no layout found in {layout_tries} attempts: {len(areas.keepout) - 1} objects are "
                "too many for the space"
            )
        # Crowded layouts fail often: make many attempts at once, each with its own stream.
        keys = stream_keys(streams, index[waiting], _AT_ONCE).ravel()
        tried, complete = _attempt(Streams(keys), np.arange(len(keys)), areas)
        complete = complete.reshape(-1, _AT_ONCE)
        found, first = complete.any(axis=1), complete.argmax(axis=1)
        tried = tried.reshape(-1, _AT_ONCE, *tried.shape[1:])
        layout[waiting[found]] = tried[found, first[found]]
        waiting, attempts = waiting[~found], attempts + _AT_ONCE
    return layout


def stream_keys(streams: Streams, index: NDArray[np.intp], count: int) -> NDArray[np.uint64]:
    """Draw keys for `count` further streams of each environment: [len(index), count]."""
    draw = streams.uniform(index, draws=(count + 1) // 2)[:, : 2 * count]
    words = (draw * 2.0**32).astype(np.uint64).reshape(len(index), count, 2)
    return words[..., 0] << np.uint64(32) | words[..., 1]


def sample_again(
    streams: Streams, index: NDArray[np.intp], areas: Areas, row: int, layout: Floats
) -> tuple[Floats, NDArray[np.bool_]]:
    """Draw a new place for the object `row` among the others, and return whether one was found.

    layout: [len(index), objects, 2] -> [len(index), 2], bool [len(index)]. The new place may
    overlap the old one. If none of 10 000 points is free, the old place is returned.
    """
    keepout = areas.keepout
    others, apart = np.delete(layout, row, axis=1), keepout[row] + np.delete(keepout, row)
    first = _unit_points(streams, index, _BLOCK)
    area = areas.centre[row], areas.half[row]
    place, found = _first_free(streams, index, first, area, others, apart, GOAL_TRIES)
    return np.where(found[:, None], place, layout[:, row]), found


def _attempt(
    streams: Streams, index: NDArray[np.intp], areas: Areas
) -> tuple[Floats, NDArray[np.bool_]]:
    """Try to draw layouts once -> [len(index), objects, 2], and whether complete [len(index)]."""
    count = len(areas.keepout)
    layout = np.empty((len(index), count, 2))
    complete = np.ones(len(index), dtype=bool)
    # One large draw, most likely enough for all objects, costs less than a draw for each.
    points = _unit_points(streams, index, count * _BLOCK).reshape(-1, count, _BLOCK, 2)
    for i in range(count):
        layout[complete, i], complete[complete] = _first_free(
            streams,
            index[complete],
            points[complete, i],
            (areas.centre[i], areas.half[i]),
            layout[complete, :i],
            areas.keepout[i] + areas.keepout[:i],
            OBJECT_TRIES,
        )
        if not complete.any():
            break
    return layout, complete


def _first_free(
    streams: Streams,
    index: NDArray[np.intp],
    points: Floats,
    area: tuple[Floats, Floats],
    others: Floats,
    apart: Floats,
    tries: int,
) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the first of `tries` points of each environment that is clear of the others.

    points: the first block of points, in units of the area, [n, block, 2]; area: centre and
    half-widths, [2] each; others: [n, k, 2]; apart: [k], least distances -> [n, 2] (any tried point
    if none is free), and whether it is free, bool [n].
    """
    centre, half = area
    place, found = _pick(centre + points * half, others, apart)
    tried = _BLOCK
    while tried < tries and not found.all():
        waiting = np.flatnonzero(~found)
        block = min(9 * tried, tries - tried)
        points = centre + _unit_points(streams, index[waiting], block) * half
        place[waiting], found[waiting] = _pick(points, others[waiting], apart)
        tried += block
    return place, found


def _pick(points: Floats, others: Floats, apart: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the first of points [n, block, 2] that is `apart` [k] from others [n, k, 2], and
    whether there is one."""
    dx = points[:, :, None, 0] - others[:, None, :, 0]
    dy = points[:, :, None, 1] - others[:, None, :, 1]
    free = np.logical_and.reduce(np.sqrt(dx * dx + dy * dy) >= apart, axis=-1)
    rows, first = np.arange(len(points)), free.argmax(axis=-1)
    return points[rows, first], free[rows, first]


def _unit_points(streams: Streams, index: NDArray[np.intp], count: int) -> Floats:
    """Draw uniform points in the square [-1, 1]² from each stream: [len(index), count, 2]."""
    return 2.0 * streams.uniform(index, draws=count // 2).reshape(-1, count, 2) - 1.0
