"""The cost region: a disc less its cut-outs. Its other forms are derived from this one."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray


class HasRegion(Protocol):
    """The part of `Circle2DConfig`, which imports this module, that shapes the region."""

    @property
    def level(self) -> int: ...
    @property
    def constraint_radius(self) -> float: ...
    @property
    def corridor_height_factor(self) -> float: ...


class CutOut(NamedTuple):
    """A half-open strip of free space: `along >= inner` and `|across| <= half_width`.

    `along = p·(cos, sin)` and `across = p·(-sin, cos)` in world units. It stands for its mirror
    image in the x axis too.
    """

    name: str
    cos: float
    sin: float
    inner: float
    half_width: float


def cutouts(level: int, radius: float, height_factor: float) -> tuple[CutOut, ...]:
    """Return the strips of a level with y >= 0: corridor, top (level 2), +45° (level 3).

    The corridor ends 0.05 R short of the centre, the top one 0.5 R deep, the +45° one 0.3 R deep
    and half as wide. No strip but the corridor reaches the x axis, for any height factor up to 2.
    """
    half_width = height_factor * radius / 2
    corridor = CutOut("corridor", -1.0, 0.0, 0.05 * radius, half_width)
    top = CutOut("cut-out", 0.0, 1.0, 0.5 * radius, half_width)
    half = math.sqrt(0.5)
    diagonal = CutOut("diagonal cut-out", half, half, 0.7 * radius, half_width / 2)
    return (corridor, top, diagonal)[: max(1, level)]


class CostRegion:
    """The open disc `‖p‖ < R` less the corridor and the level's cut-outs.

    It is symmetric in the x axis, and so are its tests, bit for bit. Source: safe_exploration.tex,
    "Circle2D details" and the figure of the levels; the cut-outs' sizes define version v0.
    """

    def __init__(self, config: HasRegion) -> None:
        radius = config.constraint_radius
        self._shape(radius, cutouts(config.level, radius, config.corridor_height_factor))

    def _shape(self, radius: float, cutouts: tuple[CutOut, ...]) -> None:
        self.radius, self.cutouts = radius, cutouts
        self._strips = [
            (_Linear.of(cut.cos, cut.sin, cut.inner), _Linear.of(-cut.sin, cut.cos, cut.half_width))
            for cut in self.cutouts
        ]

    def contains(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Test whether points lie in the cost region. The rim is not part of it.

        points: [..., 2] world units -> [...] bool.
        """
        return _test(self._contains, points)

    def in_cutout(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Test whether points lie in the corridor or a cut-out; these extend beyond the disc.

        points: [..., 2] world units -> [...] bool.
        """
        return _test(self._in_cutout, points)

    def depth(self, points: ArrayLike) -> NDArray[np.float64]:
        """Return the distance of points to free space: 0 outside the region.

        points: [..., 2] world units -> [...] world units.
        """
        points = np.asarray(points, dtype=np.float64)
        x, y = points[..., 0], np.abs(points[..., 1])  # of mirror images, the nearer one
        depth: NDArray[np.float64] = self.radius - np.hypot(x, y)
        for cut in self.cutouts:
            before = cut.inner - (x * cut.cos + y * cut.sin)
            beside = np.abs(y * cut.cos - x * cut.sin) - cut.half_width
            depth = np.minimum(depth, np.hypot(np.maximum(before, 0), np.maximum(beside, 0)))
        return np.asarray(np.where(self.contains(points), depth, 0.0))

    def grown(self, margin: float) -> CostRegion:
        """Return the region grown by `margin`, world units. At the corners where a cut-out meets
        the rim or another cut-out it grows by a little more."""
        grown = copy.copy(self)
        narrower = [
            cut._replace(inner=cut.inner + margin, half_width=cut.half_width - margin)
            for cut in self.cutouts
        ]
        grown._shape(self.radius + margin, tuple(narrower))
        return grown

    def places(self, points: ArrayLike) -> list[str]:
        """Name the place of each point: "cost region", "corridor", "top cut-out",
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
        """Return the length of the shortest way through the region into the corridor, along the
        axis on which it is longer; world units. It begins outside the disc, right of the corridor's
        inner end, or in another cut-out. 0 where no region lies between.
        """
        corridor, *others = self.cutouts
        end, half = corridor.inner, corridor.half_width
        # Diagonally to the rim: (t - end)² + (t + half)² = R².
        shift, rest = half - end, (end * end + half * half - self.radius * self.radius) / 2
        found = [-shift / 2 + math.sqrt(shift * shift / 4 - rest)]
        for cut in others:  # from the corners of its inner end
            for across in (-cut.half_width, cut.half_width):
                x = cut.inner * cut.cos - across * cut.sin
                y = cut.inner * cut.sin + across * cut.cos
                found.append(max(x + end, y - half))
        return max(min(found), 0.0)

    # These take coordinates with y >= 0, as arrays or as plain floats, and return bools to match.

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
    """`a·x + b·y` against a bound, all scaled so that a and b are 0 or ±1 for every strip.

    Multiplying by them is then superfluous, and most of a step's time would go there.
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
    """The answers of a test that takes x and |y| to points [..., 2]."""
    points = np.asarray(points, dtype=np.float64)
    if points.ndim == 0 or points.shape[-1] != 2:
        raise ValueError(f"points must have shape [..., 2], got {list(points.shape)}")
    if points.size == 2:
        # One point: the same formulas on plain floats, without numpy's cost per call.
        x, y = points.ravel().tolist()
        return np.full(points.shape[:-1], test(x, abs(y)))
    return test(points[..., 0], np.abs(points[..., 1]))
