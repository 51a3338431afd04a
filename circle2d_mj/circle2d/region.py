"""The cost region, a disc without its cut-outs, and the area in which episodes start."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from circle2d_mj.core.streams import Streams

if TYPE_CHECKING:
    from circle2d_mj.circle2d.config import Circle2DConfig


class CutOut(NamedTuple):
    """A half-open strip of free space: `along >= inner` and `|across| <= half_width`.

    `along = p·(cos, sin)` and `across = p·(-sin, cos)` in world units. The mirror image in the x
    axis is free space too.
    """

    name: str
    cos: float
    sin: float
    inner: float
    half_width: float


def cutouts(
    level: int, radius: float, height_factor: float, depth: float = 0.5
) -> tuple[CutOut, ...]:
    """Return the strips of a level with y >= 0: corridor, top (level 2), +45° (level 3).

    The corridor ends 0.05 R before the centre; the top cut-out is `depth` R deep, and the +45°
    cut-out is 0.6 times as deep and half as wide. Only the corridor reaches the x axis, for any
    height factor up to 2 and depth up to 0.8.
    """
    half_width = height_factor * radius / 2
    corridor = CutOut("corridor", -1.0, 0.0, 0.05 * radius, half_width)
    top = CutOut("cut-out", 0.0, 1.0, (1 - depth) * radius, half_width)
    half = math.sqrt(0.5)
    inner = (1 - 0.6 * depth) * radius
    diagonal = CutOut("diagonal cut-out", half, half, inner, half_width / 2)
    return (corridor, top, diagonal)[: max(1, level)]


class CostRegion:
    """The open disc `‖p‖ < R` without the corridor and the level's cut-outs.

    It is symmetric in the x axis, and so are the results of its methods, bit for bit. Source:
    safe_exploration.tex, "Circle2D details" and the figure of the levels; the sizes of the cut-outs
    define version v0.
    """

    def __init__(self, config: Circle2DConfig) -> None:
        radius = config.constraint_radius
        height, depth = config.corridor_height_factor, config.cutout_depth
        self._shape(radius, cutouts(config.level, radius, height, depth))

    def _shape(self, radius: float, cutouts: tuple[CutOut, ...]) -> None:
        self.radius, self.cutouts = radius, cutouts
        self._strips = [
            (_Linear.of(cut.cos, cut.sin, cut.inner), _Linear.of(-cut.sin, cut.cos, cut.half_width))
            for cut in self.cutouts
        ]

    def contains(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Test whether points lie in the cost region, without its rim.

        points: [..., 2] world units -> [...] bool.
        """
        return _test(self._contains, points)

    def in_cutout(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Test whether points lie in the corridor or a cut-out, which extend beyond the disc.

        points: [..., 2] world units -> [...] bool.
        """
        return _test(self._in_cutout, points)

    def depth(self, points: ArrayLike) -> NDArray[np.float64]:
        """Return the distance of points to free space, 0 outside the region.

        points: [..., 2] world units -> [...] world units.
        """
        points = np.asarray(points, dtype=np.float64)
        x, y = points[..., 0], np.abs(points[..., 1])  # of two mirror images, the nearer counts
        depth: NDArray[np.float64] = self.radius - np.hypot(x, y)
        for cut in self.cutouts:
            before = cut.inner - (x * cut.cos + y * cut.sin)
            beside = np.abs(y * cut.cos - x * cut.sin) - cut.half_width
            depth = np.minimum(depth, np.hypot(np.maximum(before, 0), np.maximum(beside, 0)))
        return np.asarray(np.where(self.contains(points), depth, 0.0))

    def grown(self, margin: float) -> CostRegion:
        """Return the region grown by `margin`, world units; by slightly more at corners where a
        cut-out meets the rim or another cut-out."""
        grown = copy.copy(self)
        narrower = [
            cut._replace(inner=cut.inner + margin, half_width=cut.half_width - margin)
            for cut in self.cutouts
        ]
        grown._shape(self.radius + margin, tuple(narrower))
        return grown

    def places(self, points: ArrayLike) -> list[str]:
        """Return the name of each point's place: "cost region", "corridor", "top cut-out",
        "bottom diagonal cut-out", "right rim" (anywhere outside the disc on that side), ...

        points: [N, 2] world units.
        """
        return [self._place(x, y) for x, y in np.asarray(points, dtype=np.float64).tolist()]

    def _place(self, x: float, y: float) -> str:
        upright = "top" if y >= 0 else "bottom"
        if x * x + y * y >= self.radius * self.radius:
            sideways = "right" if x >= 0 else "left"
            return f"{sideways if abs(x) >= abs(y) else upright} rim"
        for cut, strip in zip(self.cutouts, self._strips, strict=True):
            if self._in_strip(strip, x, abs(y)):
                return cut.name if cut.sin == 0 else f"{upright} {cut.name}"
        return "cost region"

    def crossing(self) -> float:
        """Return the length of the shortest way through the region into the corridor, measured on
        the axis along which it is longer, world units. Ways start outside the disc and right of the
        corridor's inner end, or in another cut-out. 0 if no region lies in between.
        """
        corridor, *others = self.cutouts
        end, half = corridor.inner, corridor.half_width
        # Diagonally from the corridor's corner to the rim: (t - end)² + (t + half)² = R².
        shift, rest = half - end, (end * end + half * half - self.radius * self.radius) / 2
        found = [-shift / 2 + math.sqrt(shift * shift / 4 - rest)]
        for cut in others:  # from the corners of the cut-out's inner end
            for across in (-cut.half_width, cut.half_width):
                x = cut.inner * cut.cos - across * cut.sin
                y = cut.inner * cut.sin + across * cut.cos
                found.append(max(x + end, y - half))
        return max(min(found), 0.0)

    # These methods take coordinates with y >= 0, arrays or floats, and return bools likewise.

    def _contains(self, x: Any, y: Any) -> Any:
        in_disc = x * x + y * y < self.radius * self.radius
        return in_disc & (self._in_cutout(x, y) ^ True)

    def _in_cutout(self, x: Any, y: Any) -> Any:
        free = False
        for strip in self._strips:
            free = free | self._in_strip(strip, x, y)
        return free

    @staticmethod
    def _in_strip(strip: tuple[_Linear, _Linear], x: Any, y: Any) -> Any:
        along, across = strip
        return (along.value(x, y) >= along.bound) & (abs(across.value(x, y)) <= across.bound)


class _Linear(NamedTuple):
    """A linear form `a·x + b·y` and its bound, scaled so that a and b are 0 or ±1 for every strip.

    The multiplications, which would take most of a step's time, are then unnecessary.
    """

    a: float
    b: float
    bound: float

    @classmethod
    def of(cls, a: float, b: float, bound: float) -> _Linear:
        scale = max(abs(a), abs(b))
        return cls(a / scale, b / scale, bound / scale)

    def value(self, x: Any, y: Any) -> Any:
        if self.a == 0.0:
            return _times(self.b, y)
        if self.b == 0.0:
            return _times(self.a, x)
        return _times(self.a, x) + _times(self.b, y)


def _times(factor: float, values: Any) -> Any:
    return values if factor == 1.0 else factor * values


def _test(test: Callable[[Any, Any], Any], points: ArrayLike) -> NDArray[np.bool_]:
    """Apply a test of x and |y| to points [..., 2] -> [...] bool."""
    points = np.asarray(points, dtype=np.float64)
    if points.ndim == 0 or points.shape[-1] != 2:
        raise ValueError(f"points must have shape [..., 2], got {list(points.shape)}")
    if points.size == 2:
        # One point: the same formulas on plain floats, without NumPy's cost per call.
        x, y = points.ravel().tolist()
        return np.full(points.shape[:-1], test(x, abs(y)))
    return test(points[..., 0], np.abs(points[..., 1]))


Rectangle = tuple[tuple[float, float], tuple[float, float]]
"""Lower and upper corner, ((x, y), (x, y)), in world units."""

# With this share of free cells few draws are rejected. Draws take most of the time of a reset.
_FREE_SHARE = 0.9
# Halving 26 times resolves a feasible patch of 1e-8 of the rectangle's side.
_MAX_SPLITS = 26
# Classifying this number of cells takes 1.6 GB.
_MAX_CELLS = 2**23


class StartArea:
    """A rectangle without a region, sampled exactly even if little of it is left.

    The rectangle is split into equal cells, and cells that surely lie in the region are dropped,
    until nearly all remaining cells are surely free. `sample` draws a cell and a point in it, and
    repeats both while the point lies in the region, so that points are uniform over the feasible
    part. region=None: uniform over the whole rectangle. Raises ValueError if nothing feasible is
    left, or just an edge so thin that millions of cells would be needed.
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
            # If a cut-out only touches the rectangle, each split doubles the cells along its edge,
            # and none becomes free. If it overlaps by less than a cell, enough cells are free once
            # they are a tenth as long, and then there are 100 times as many.
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
    """Return masks of the cells that surely lie in the region and surely outside: two bool [n].

    low: [n, 2] lower corners, size: [2]. Cells near the edges of cut-outs may be in neither mask.
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
