"""Circle2D painted flat: what the floor of a picture shows. Needs no OpenGL.

Images are [size, size, 3] uint8 of the whole arena, x to the right and y upwards.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw

from circle2d_mj.circle2d.config import Circle2DConfig

Picture = NDArray[np.uint8]

FREE, REGION = (252, 252, 252), (190, 190, 190)
START, START_IN_REGION = (222, 238, 218), (166, 190, 160)
CROSS, WALL, DOT, LINE, BOX = (
    (20, 20, 20),
    (90, 90, 90),
    (28, 84, 200),
    (85, 125, 210),
    (240, 130, 10),
)
RING_SHADE = 0.75
"""How much darker the circles of equal reward are than what lies below them."""
HEAT = ((0, 0, 110), (0, 70, 255), (0, 200, 215), (250, 215, 20), (215, 20, 0))
"""From one visit to the most, in equal steps of the visits' logarithm."""
OPACITY = 0.85
"""Of the heat, so that the region's edges stay visible below it."""
# Everything is painted this much larger and averaged, so that edges are smooth.
_FINER = 2


def background(config: Circle2DConfig, size: int) -> Picture:
    """The task: what `ground` shows, and an X on the optimum."""
    return with_cross(ground(config, size), config)


def ground(config: Circle2DConfig, size: int) -> Picture:
    """The region grey, with a wall round it where it is rigid, the start area green, and circles of
    equal reward every R/4, in wide arenas R/2, R and so on."""
    fine = size * _FINER
    axis = (np.arange(fine) + 0.5) / fine * 2 - 1
    x, y = np.meshgrid(axis * config.arena, -axis * config.arena)
    points = np.stack((x, y), axis=-1)
    inside = config.region.contains(points)
    (left, low), (right, high) = config.start_rectangle
    starts = (left <= x) & (x <= right) & (low <= y) & (y <= high)
    if not config.allow_infeasible_init:
        starts &= ~inside
    image = np.where(inside[..., None], REGION, FREE).astype(np.float64)
    image[starts] = np.where(inside[starts, None], START_IN_REGION, START)
    if not config.infeasible_region_penetratable:
        image[inside & ~_within(inside, fine // 400)] = WALL
    ring = config.constraint_radius / 4
    while ring * size < 16 * config.arena:  # closer than 8 pixels they would look like one shade
        ring *= 2
    distance = np.hypot(x - config.optima_perturbation[0], y - config.optima_perturbation[1])
    line = 0.6 * 2 * config.arena / size  # half of 1.2 pixels
    on_ring = np.abs(distance - ring * np.round(distance / ring)) < line
    image[on_ring] *= RING_SHADE
    return np.asarray(Image.fromarray(np.round(image).astype(np.uint8)).reduce(_FINER))


def with_trajectories(
    image: Picture,
    config: Circle2DConfig,
    paths: Sequence[ArrayLike],
    costs: Sequence[ArrayLike],
    boxed: bool = True,
) -> Picture:
    """The image with trajectories: a blue dot for each state, and an orange box around each chain
    of consecutive cost steps.

    paths: [T + 1, 2] each, world units, the start first; costs: [T] each, those of the steps;
    boxed: or else states that cost are orange dots, since boxes of many trajectories overlap.
    Source: the figure of two trajectories with equal costs. ValueError where paths and costs do not
    fit together or are not finite.
    """
    if len(paths) != len(costs):
        raise ValueError(f"{len(paths)} paths need as many rows of costs, got {len(costs)}")
    fine = len(image) * _FINER
    painted = Image.fromarray(image).resize((fine, fine), Image.Resampling.NEAREST)
    draw = ImageDraw.Draw(painted)
    dot, line = fine / 160, max(fine // 500, 1)
    checked = [_checked(*given) for given in zip(paths, costs, strict=True)]
    lines = [pixels(config, path, fine) for path in checked]
    for at in lines:
        draw.line([tuple(p) for p in at.tolist()], fill=LINE, width=line)
    for at, of_path in zip(lines, costs, strict=True):
        costly = np.concatenate(([False], np.asarray(of_path) > 0)) & (not boxed)
        for (column, row), orange in zip(at.tolist(), costly, strict=True):
            corners = (column - dot, row - dot, column + dot, row + dot)
            draw.ellipse(corners, fill=BOX if orange else DOT)
    for at, of_path in zip(lines, costs, strict=True) if boxed else ():
        for first, last in chains(of_path):
            # A step's cost is that of the state it ends in.
            low, high = at[first + 1 : last + 2].min(axis=0), at[first + 1 : last + 2].max(axis=0)
            corners = (*(low - 2.2 * dot), *(high + 2.2 * dot))
            draw.rectangle(corners, outline=BOX, width=3 * line)
    return np.asarray(painted.reduce(_FINER))


def _checked(path: ArrayLike, costs: ArrayLike) -> NDArray[np.float64]:
    points, of_steps = np.asarray(path, dtype=np.float64), np.asarray(costs, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 2 or not len(points):
        raise ValueError(f"a path must have shape [T + 1, 2], got {list(points.shape)}")
    steps = len(points) - 1
    if of_steps.shape != (steps,):
        raise ValueError(
            f"a path of {len(points)} states needs {steps} costs, got {list(of_steps.shape)}"
        )
    if not (np.isfinite(points).all() and np.isfinite(of_steps).all()):
        raise ValueError("paths and costs must be finite")
    return points


def with_counts(image: Picture, counts: NDArray[np.int64], most: int) -> Picture:
    """The image with the cells that were visited coloured by how often.

    counts: [cells, cells] of `visits`; most: the visits that the last colour stands for, which
    pictures that are to be compared have in common.
    """
    cell = ((np.arange(len(image)) + 0.5) * len(counts) / len(image)).astype(np.intp)
    share = np.log(np.maximum(counts, 1)) / np.log(max(most, 2))
    colours = heat_colours(share)[cell[:, None], cell]
    visited = (counts > 0)[cell[:, None], cell, None]
    blended = (colours * OPACITY + image * (1 - OPACITY)).astype(np.uint8)
    return np.where(visited, blended, image)


def with_cross(image: Picture, config: Circle2DConfig) -> Picture:
    """The image with an X on the optimum, on top of whatever was painted there."""
    painted, size = Image.fromarray(image), len(image)
    column, row = pixels(config, config.optima_perturbation, size)
    arm, width, reach = size / 55, max(size // 160, 1), size // 40 + 2
    left, top = int(column) - reach, int(row) - reach
    patch = painted.crop((left, top, left + 2 * reach, top + 2 * reach))
    patch = patch.resize((2 * reach * _FINER, 2 * reach * _FINER), Image.Resampling.NEAREST)
    draw = ImageDraw.Draw(patch)
    x, y, arm = (column - left) * _FINER, (row - top) * _FINER, arm * _FINER
    for colour, thickness in ((FREE, 2 * width * _FINER), (CROSS, width * _FINER)):
        for slope in (1, -1):
            ends = (x - arm, y - slope * arm, x + arm, y + slope * arm)
            draw.line(ends, fill=colour, width=thickness)
    painted.paste(patch.reduce(_FINER), (left, top))
    return np.asarray(painted)


def _within(inside: NDArray[np.bool_], distance: int) -> NDArray[np.bool_]:
    """What is inside together with all that lies `distance` up, down, left and right of it."""
    within = inside.copy()
    for axis in (0, 1):
        for shift in (distance, -distance):
            within &= np.roll(inside, shift, axis)
    return within


def visits(config: Circle2DConfig, positions: ArrayLike, cells: int) -> NDArray[np.int64]:
    """How often each cell was visited: [cells, cells], the row of the greatest y first.

    positions: [N, 2] world units. What lies up to a tenth beyond the arena, as a ball pressed
    against its edge may, counts for the cell at the edge. ValueError for what lies farther out or
    is not finite.
    """
    positions = np.asarray(positions)
    if positions.ndim != 2 or positions.shape[1] != 2:
        raise ValueError(f"positions must have shape [N, 2], got {list(positions.shape)}")
    if positions.size and not np.abs(positions).max() <= 1.1 * config.arena:
        raise ValueError(
            f"positions must be finite and in the arena, up to {config.arena:g} on each axis, "
            f"got one as far as {np.abs(positions).max():g}"
        )
    scale = cells / (2 * config.arena)
    column = (positions[:, 0] + config.arena) * scale
    row = (config.arena - positions[:, 1]) * scale
    index = np.clip(row.astype(np.int32), 0, cells - 1) * np.int32(cells)
    index += np.clip(column.astype(np.int32), 0, cells - 1)
    return np.bincount(index, minlength=cells * cells).reshape(cells, cells)


def heat_colours(share: NDArray[np.float64]) -> Picture:
    """The colours of shares between 0 (one visit) and 1 (the most): [..., 3]."""
    place = share * (len(HEAT) - 1)
    stops = np.array(HEAT, dtype=np.float64)
    channels = [np.interp(place, np.arange(len(HEAT)), stops[:, k]) for k in range(3)]
    return np.stack(channels, axis=-1).round().astype(np.uint8)


def pixels(config: Circle2DConfig, points: ArrayLike, size: int) -> NDArray[np.float64]:
    """Where points lie in an image: [..., 2] world units -> [..., 2] column and row."""
    points = np.asarray(points, dtype=np.float64)
    if points.shape[-1:] != (2,):
        raise ValueError(f"points must have shape [..., 2], got {list(points.shape)}")
    return (points * (1, -1) + config.arena) * (size / (2 * config.arena))


def chains(costs: ArrayLike) -> list[tuple[int, int]]:
    """First and last step of every chain of consecutive steps with a cost above 0. costs: [T]."""
    unsafe = np.concatenate(([False], np.asarray(costs) > 0, [False])).astype(np.int8)
    changes = np.diff(unsafe)
    first, after = np.flatnonzero(changes == 1), np.flatnonzero(changes == -1)
    return list(zip(first.tolist(), (after - 1).tolist(), strict=True))
