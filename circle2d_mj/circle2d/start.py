"""Starts of episodes: uniform over a rectangle, outside the cost region."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from circle2d_mj.circle2d.region import CostRegion
from circle2d_mj.core.streams import Streams

Rectangle = tuple[tuple[float, float], tuple[float, float]]
"""Lower and upper corner, ((x, y), (x, y)), in world units."""

# Few draws are then rejected; they make up most of the time of a reset of many environments.
_FREE_SHARE = 0.9
# Halving 26 times resolves a feasible patch of 1e-8 of the rectangle's side.
_MAX_SPLITS = 26
# Classifying as many cells takes 1.6 GB.
_MAX_CELLS = 2**23


class StartArea:
    """A rectangle less a region, sampled exactly even where little of it is left.

    The rectangle is split into equal cells, and cells that surely lie in the region are dropped,
    until nearly all that is left is surely free. A cell is then drawn, a point in it, and both
    again while the point lies in the region: uniform over the feasible part. region=None: uniform
    over all of the rectangle. Raises ValueError where nothing feasible is left, or no more than an
    edge so thin that millions of cells would be needed.
    """

    def __init__(self, rectangle: Rectangle, region: CostRegion | None) -> None:
        low, high = np.array(rectangle)
        self._region = region
        self._corners, self._size = low[None], high - low
        if region is not None:
            self._split(region)

    def sample(self, streams: Streams, index: NDArray[np.intp]) -> NDArray[np.float64]:
        """Draw start positions for the environments `index`: [len(index), 2], world units."""
        positions = np.empty((len(index), 2))
        waiting = np.arange(len(index))
        while len(waiting):
            draw = streams.uniform(index[waiting])
            cells = (draw[:, 0] * len(self._corners)).astype(np.intp)
            points = self._corners[cells] + draw[:, 1:3] * self._size
            positions[waiting] = points
            if self._region is None:
                break
            waiting = waiting[self._region.contains(points)]
        return positions

    def _split(self, region: CostRegion) -> None:
        for _ in range(_MAX_SPLITS):
            infeasible, free = classify_cells(region, self._corners, self._size)
            self._corners, free = self._corners[~infeasible], free[~infeasible]
            if len(free) and free.mean() >= _FREE_SHARE:
                return
            # At the edge of a cut-out that only touches the rectangle each split doubles the cells,
            # and none gets free. Where it overlaps, but by less than a cell, enough are free when
            # cells are a tenth as long, and there are 100 times as many.
            if len(free) * (4 if free.any() else 100) > _MAX_CELLS:
                break
            self._size = self._size / 2
            offsets = np.array([(0, 0), (0, 1), (1, 0), (1, 1)]) * self._size
            self._corners = (self._corners[:, None] + offsets).reshape(-1, 2)
        raise ValueError(
            "no feasible start is left, or too little to draw from: the start area "
            "(init_region_size, init_radius_multiplier) lies in the cost region; enlarge it or set "
            "allow_infeasible_init"
        )


def classify_cells(
    region: CostRegion, low: NDArray, size: NDArray
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which cells surely lie in the region, and which surely outside: two bool [n].

    low: [n, 2] lower corners, size: [2]. Cells near the edges of cut-outs may be neither.
    """
    corners = low[:, None] + np.array([(0, 0), (0, 1), (1, 0), (1, 1)]) * size
    farthest = np.hypot(*np.abs(corners).max(axis=1).T)
    nearest = np.hypot(*np.clip(0.0, low, low + size).T)
    touches_cutout = np.zeros(len(low), dtype=bool)
    in_one_cutout = np.zeros(len(low), dtype=bool)
    for cut in region.cutouts:
        for sin in {cut.sin, -cut.sin}:
            along = corners @ np.array([cut.cos, sin])
            across = corners @ np.array([-sin, cut.cos])
            touches_cutout |= (
                (along.max(axis=1) >= cut.inner)
                & (across.max(axis=1) >= -cut.half_width)
                & (across.min(axis=1) <= cut.half_width)
            )
            in_one_cutout |= (along.min(axis=1) >= cut.inner) & (
                np.abs(across).max(axis=1) <= cut.half_width
            )
    infeasible = (farthest < region.radius) & ~touches_cutout
    return infeasible, (nearest >= region.radius) | in_one_cutout
