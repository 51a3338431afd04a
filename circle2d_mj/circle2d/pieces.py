"""The cost region as convex polygons, for MuJoCo's contact geometry."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from circle2d_mj.circle2d.region import CostRegion

VERTICES = 256
"""Vertices of the polygon that stands for the disc and has the disc's area"""
OVERHANG = 1e-4
"""Greatest distance of that polygon's edge from the circle, as a multiple of R"""


def convex_pieces(region: CostRegion, overlap: float = 0.0) -> list[NDArray[np.float64]]:
    """Split the region into convex polygons: [vertices, 2] each, world units.

    Each strip is cut out of every piece that it meets. The parts to its left, to its right and
    behind its inner end remain; the latter reaches so far into the others. 3 pieces on level 1, 7
    on level 2, 11 on level 3, or more with an overlap.
    """
    half_angle = math.pi / VERTICES
    radius = region.radius * math.sqrt(2 * half_angle / math.sin(2 * half_angle))
    angles = 2 * half_angle * np.arange(VERTICES)
    pieces = [radius * np.column_stack((np.cos(angles), np.sin(angles)))]
    for cut in region.cutouts:
        for sin in dict.fromkeys((cut.sin, -cut.sin)):
            along, across = np.array([cut.cos, sin]), np.array([-sin, cut.cos])
            how = (along, across, *cut[-2:], overlap)
            pieces = [part for piece in pieces for part in _less(piece, *how)]
    # A sliver's area does not matter, and its volume is too small for a convex hull.
    return [piece for piece in pieces if _area(piece) > 1e-9 * region.radius**2]


def _less(
    piece: NDArray,
    along: NDArray,
    across: NDArray,
    inner: float,
    half_width: float,
    overlap: float,
) -> list[NDArray]:
    """Split a convex polygon less the strip `p·along >= inner`, `|p·across| <= half_width`."""
    between = _clip(_clip(piece, across, -half_width), -across, -half_width)
    if not len(_clip(between, along, inner)):
        return [piece]
    wide = _clip(_clip(piece, across, -half_width - overlap), -across, -half_width - overlap)
    sides = [_clip(piece, across, half_width), _clip(piece, -across, half_width)]
    return [part for part in (_clip(wide, -along, -inner), *sides) if len(part)]


def _clip(polygon: NDArray, normal: NDArray, bound: float) -> NDArray:
    """Return the part of a convex polygon where `p·normal >= bound`; no vertices if empty."""
    beyond = polygon @ normal - bound
    vertices = []
    for k in range(len(polygon)):
        here, there = beyond[k - 1], beyond[k]
        if here * there < 0:
            vertices.append(polygon[k - 1] + (polygon[k] - polygon[k - 1]) * here / (here - there))
        if there >= 0:
            vertices.append(polygon[k])
    return np.array(vertices) if len(vertices) > 2 else np.empty((0, 2))


def _area(polygon: NDArray) -> float:
    x, y = polygon.T
    return 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))
