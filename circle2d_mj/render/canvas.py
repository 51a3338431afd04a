"""Pictures of positions: background, heat maps, trajectories, outlines. Needs no OpenGL.

Pictures are [size, size, 3] uint8 and show an extent (left, right, bottom, top), in the unit of
the positions: x points to the right and y upwards.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw, ImageFont

from circle2d_mj.core.view import Extent, Picture

FREE, REGION, INK = (252, 252, 252), (190, 190, 190), (20, 20, 20)
DOT, LINE, BOX = (28, 84, 200), (85, 125, 210), (240, 130, 10)
AGENT = (200, 30, 30)
# fmt: off
HEAT = (
    (253, 231, 37), (216, 226, 25), (173, 220, 48), (132, 212, 75), (94, 201, 98),
    (63, 188, 115), (40, 174, 128), (31, 160, 136), (33, 145, 140), (38, 130, 142),
    (44, 114, 142), (51, 99, 141), (59, 82, 139), (66, 64, 134), (71, 45, 123),
    (72, 24, 106), (68, 1, 84),
)
# fmt: on
"""Colours of heat maps from one visit to the most, in equal steps of log visits: matplotlib's
viridis from light to dark. More visits are darker, also in greyscale and for colour-blind readers.
"""
QUANTILE = 0.99
"""Share of the visited cells that the scale of a heat map covers: see `most_visits`."""
FINER = 2
"""Factor by which shapes are painted larger and then averaged, so that their edges are smooth."""


def points_of_pixels(extent: Extent, size: int) -> NDArray[np.float64]:
    """Return the positions of a picture's pixels (their centres): [size, size, 2]."""
    left, right, bottom, top = extent
    share = (np.arange(size) + 0.5) / size
    x, y = np.meshgrid(left + share * (right - left), top - share * (top - bottom))
    return np.stack((x, y), axis=-1)


def pixels(extent: Extent, points: ArrayLike, size: int) -> NDArray[np.float64]:
    """Return column and row of points in a picture: [..., 2] positions -> [..., 2].

    Raises ValueError for any other shape.
    """
    points = np.asarray(points, dtype=np.float64)
    if points.shape[-1:] != (2,):
        raise ValueError(f"points must have shape [..., 2], got {list(points.shape)}")
    left, right, bottom, top = extent
    return (points - (left, top)) * (size / (right - left), size / (bottom - top))


def most_visits(counts: Sequence[NDArray[np.int64]], quantile: float = QUANTILE) -> int:
    """Return the visits, at least 1, that get the darkest colour in heat maps with a common scale.

    counts: the counts of each map, see `core.view.histogram`. The result is the `quantile` of the
    counts of all visited cells, since a few higher counts, such as where agents wait for the end of
    an episode, would flatten the scale.
    """
    visited = np.concatenate([np.zeros(0, dtype=np.int64), *(c[c > 0] for c in counts)])
    return int(np.quantile(visited, quantile, method="higher")) if len(visited) else 1


def heat_colours(share: NDArray[np.float64]) -> Picture:
    """Return the colours of shares from 0 (one visit) to 1 (most visits): [...] -> [..., 3]."""
    place = share * (len(HEAT) - 1)
    stops = np.array(HEAT, dtype=np.float64)
    channels = [np.interp(place, np.arange(len(HEAT)), stops[:, k]) for k in range(3)]
    return np.stack(channels, axis=-1).round().astype(np.uint8)


def heat_share(counts: NDArray[np.int64], most: int) -> NDArray[np.float64]:
    """Return the places of visits on the logarithmic scale of a heat map: [...] -> [...].

    most: see `with_counts`.
    """
    return np.minimum(np.log(np.maximum(counts, 1)) / np.log(max(most, 2)), 1.0)


def with_counts(picture: Picture, counts: NDArray[np.int64], most: int) -> Picture:
    """Colour the visited cells of a picture by their number of visits.

    counts: [cells, cells], see `core.view.histogram`; most: this many visits or more get the
    darkest colour; use the same number in pictures that are compared. See `most_visits`.
    """
    cell = ((np.arange(len(picture)) + 0.5) * len(counts) / len(picture)).astype(np.intp)
    colours = heat_colours(heat_share(counts, most))[cell[:, None], cell]
    return np.where((counts > 0)[cell[:, None], cell, None], colours, picture)


def with_trajectories(
    picture: Picture,
    extent: Extent,
    paths: Sequence[ArrayLike],
    costs: Sequence[ArrayLike],
    boxed: bool = True,
) -> Picture:
    """Draw trajectories on a picture: a blue dot for each state, and an orange box around each
    streak of cost steps.

    paths: [T + 1, 2] each, the start first; costs: [T] each, of the steps; boxed=False: mark the
    states that cost as orange dots instead, since boxes of many trajectories overlap. Source: the
    figure of two trajectories with equal costs. Raises ValueError if paths and costs do not fit
    together or are not finite.
    """
    if len(paths) != len(costs):
        raise ValueError(f"{len(paths)} paths need as many rows of costs, got {len(costs)}")
    fine = len(picture) * FINER
    painted = Image.fromarray(picture).resize((fine, fine), Image.Resampling.NEAREST)
    draw = ImageDraw.Draw(painted)
    dot, line = fine / 160, max(fine // 500, 1)
    for path, of_path in zip(paths, costs, strict=True):
        states, steps = np.shape(path), np.shape(of_path)
        if len(steps) != 1 or states != (steps[0] + 1, 2):
            shapes = f"got {list(states)} and {list(steps)}"
            raise ValueError(f"path and costs must be [T + 1, 2] and [T], {shapes}")
        if not (np.isfinite(path).all() and np.isfinite(of_path).all()):
            raise ValueError("paths and costs must be finite")
    lines = [pixels(extent, path, fine) for path in paths]
    for at in lines:
        draw.line([tuple(p) for p in at.tolist()], fill=LINE, width=line)
    for at, of_path in zip(lines, costs, strict=True):
        costly = np.concatenate(([False], np.asarray(of_path) > 0)) & (not boxed)
        for (column, row), orange in zip(at.tolist(), costly, strict=True):
            corners = (column - dot, row - dot, column + dot, row + dot)
            draw.ellipse(corners, fill=BOX if orange else DOT)
    for at, of_path in zip(lines, costs, strict=True) if boxed else ():
        for first, last in chains(of_path):
            # A step's cost belongs to the state that the step ends in.
            low, high = at[first + 1 : last + 2].min(axis=0), at[first + 1 : last + 2].max(axis=0)
            corners = (*(low - 2.2 * dot), *(high + 2.2 * dot))
            draw.rectangle(corners, outline=BOX, width=3 * line)
    return np.asarray(painted.reduce(FINER))


def chains(costs: ArrayLike) -> list[tuple[int, int]]:
    """Return first and last step of each streak of steps with a cost above 0. costs: [T]."""
    unsafe = np.concatenate(([False], np.asarray(costs) > 0, [False])).astype(np.int8)
    changes = np.diff(unsafe)
    first, after = np.flatnonzero(changes == 1), np.flatnonzero(changes == -1)
    return list(zip(first.tolist(), (after - 1).tolist(), strict=True))


def with_outline(picture: Picture, inside: NDArray[np.bool_]) -> Picture:
    """Draw a dark line along the edge of an area, inside the area, between two light lines.

    inside: mask of the area's pixels, in a picture `FINER` times as large.
    """
    width, outlined = max(len(inside) // 800, 1), picture.copy()
    light = ~(eroded(inside, 4 * width) | eroded(~inside, width))
    for colour, line in ((FREE, light), (INK, inside & ~eroded(inside, 3 * width))):
        covered = np.asarray(Image.fromarray(line.astype(np.uint8) * np.uint8(255)).reduce(FINER))
        at = np.nonzero(covered)
        share = covered[at][:, None] / 255
        outlined[at] = np.round(outlined[at] * (1 - share) + np.array(colour) * share)
    return outlined


def eroded(area: NDArray[np.bool_], distance: int) -> NDArray[np.bool_]:
    """Return the pixels whose neighbours `distance` up, down, left and right lie in the area.

    The area is taken to continue beyond the picture's edge.
    """
    padded, (height, width) = np.pad(area, distance, mode="edge"), area.shape
    within = area.copy()
    for shift in (0, 2 * distance):
        within &= padded[shift : shift + height, distance : distance + width]
        within &= padded[distance : distance + height, shift : shift + width]
    return within


def with_cross(picture: Picture, extent: Extent, point: ArrayLike) -> Picture:
    """Draw an X at a position, [2]."""
    painted, size = Image.fromarray(picture), len(picture)
    column, row = pixels(extent, point, size)
    arm, width, reach = size / 55, max(size // 160, 1), size // 40 + 2
    left, top = int(column) - reach, int(row) - reach
    patch = painted.crop((left, top, left + 2 * reach, top + 2 * reach))
    patch = patch.resize((2 * reach * FINER, 2 * reach * FINER), Image.Resampling.NEAREST)
    draw = ImageDraw.Draw(patch)
    x, y, arm = (column - left) * FINER, (row - top) * FINER, arm * FINER
    for colour, thickness in ((FREE, 2 * width * FINER), (INK, width * FINER)):
        for slope in (1, -1):
            ends = (x - arm, y - slope * arm, x + arm, y + slope * arm)
            draw.line(ends, fill=colour, width=thickness)
    painted.paste(patch.reduce(FINER), (left, top))
    return np.asarray(painted)


def with_agent(picture: Picture, extent: Extent, position: ArrayLike) -> Picture:
    """Draw a disc where the agent is, [2]."""
    image, radius = Image.fromarray(picture), max(len(picture) / 60, 2.5)
    column, row = pixels(extent, position, len(picture))
    corners = (column - radius, row - radius, column + radius, row + radius)
    ImageDraw.Draw(image).ellipse(corners, fill=AGENT, outline=(255, 255, 255))
    return np.asarray(image)


def with_ticks(
    picture: Picture,
    extent: Extent,
    axes: tuple[str, str],
    ticks: tuple[Sequence[float], Sequence[float]],
) -> Picture:
    """Draw numbers and names of axes along the lower and left edge of a picture.

    ticks: the numbers on each axis.
    """
    image, size = Image.fromarray(picture), len(picture)
    draw, font = ImageDraw.Draw(image), ImageFont.load_default(size / 26)
    style = {"fill": INK, "font": font, "stroke_width": max(size // 200, 1), "stroke_fill": FREE}
    across, up = ticks
    columns = pixels(extent, [(x, extent[2]) for x in across], size)[:, 0]
    rows = pixels(extent, [(extent[0], y) for y in up], size)[:, 1]
    margin = size / 60
    for x, column in zip(across, columns.tolist(), strict=True):
        draw.line((column, size - margin, column, size), fill=INK, width=max(size // 320, 1))
        draw.text((column, size - 1.2 * margin), f"{x:g}", anchor="md", **style)
    for y, row in zip(up, rows.tolist(), strict=True):
        draw.line((0, row, margin, row), fill=INK, width=max(size // 320, 1))
        # Above its tick, so that the tick does not look like a minus sign.
        draw.text((1.2 * margin, row), f"{y:g}", anchor="ld", **style)
    draw.text((size - margin, size - 5 * margin), axes[0], anchor="rd", **style)
    draw.text((margin, margin), axes[1], anchor="la", **style)
    return np.asarray(image)
