"""View of a task: positions to record and to count, and pictures to draw them on."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

Picture = NDArray[np.uint8]
"""[height, width, 3], the top row first."""
Extent = tuple[float, float, float, float]
"""Left, right, bottom and top of a picture, in the unit of the positions that it shows."""
# A ball pressed against the arena's edge is up to 1 % of the picture's width outside of it.
_BEYOND = 0.02


class View(Protocol):
    """A position (two numbers) for each state, and a picture to draw positions on.

    An environment has its view as the attribute `view`; None, or no attribute, means that there is
    nothing to show. Training records the positions and reports draw them, without knowing the task.
    A picture of positions is painted in layers: first `background`, then a heat map
    (`circle2d_mj.render.canvas.with_counts`) or trajectories (`with_trajectories`), then `overlay`.
    """

    @property
    def extent(self) -> Extent:
        """Left, right, bottom and top of the pictures, in the positions' units."""
        ...

    @property
    def axes(self) -> tuple[str, str]:
        """Names of the two numbers with their units: ("x (m)", "y (m)")."""
        ...

    def positions(
        self, observation: NDArray[np.floating], info: Mapping[str, Any]
    ) -> NDArray[np.floating]:
        """Return the positions of the observed states.

        observation: [..., observation size]; info: arrays [...] of the same steps -> [..., 2].
        """
        ...

    def places(self, positions: NDArray[np.floating]) -> list[str]:
        """Name the place of each position, [N, 2]: "corridor", "right rim"; [] if places have no
        names."""
        ...

    def background(self, size: int) -> Picture:
        """Paint the layer below heat maps and trajectories: [size, size, 3]."""
        ...

    def overlay(self, picture: Picture) -> Picture:
        """Return the picture with the layer above heat maps and trajectories: outlines, marks."""
        ...


@runtime_checkable
class TellsWays(Protocol):
    """A view that also tells which way agents took to the place where their episodes ended."""

    def ways(self, positions: NDArray[np.floating], costs: NDArray[np.floating]) -> list[str]:
        """Name the way of each agent: "round", "through"; "" if it is unknown.

        positions: [N, 2], where the episodes ended; costs: [N], of whole episodes.
        """
        ...


def histogram(extent: Extent, positions: ArrayLike, cells: int) -> NDArray[np.int64]:
    """Count the visits to each cell of a picture: [cells, cells], the top row first.

    positions: [N, 2]. A position up to 2 % of the picture's width or height beyond the edge, as of
    a ball pressed against it, counts for the cell at the edge; positions farther out do not count,
    so the sum of the counts is the number of positions in the picture. Raises ValueError for
    a wrong shape and for positions that are not finite.
    """
    positions = np.asarray(positions)
    if positions.ndim != 2 or positions.shape[1] != 2:
        raise ValueError(f"positions must have shape [N, 2], got {list(positions.shape)}")
    if not np.isfinite(positions).all():
        raise ValueError("positions must be finite")
    left, right, bottom, top = extent
    column = (positions[:, 0] - left) * (cells / (right - left))
    row = (top - positions[:, 1]) * (cells / (top - bottom))
    edge = _BEYOND * cells
    shown = np.minimum(column, row) >= -edge
    shown &= np.maximum(column, row) <= cells + edge
    index = np.clip(row[shown].astype(np.int32), 0, cells - 1) * np.int32(cells)
    index += np.clip(column[shown].astype(np.int32), 0, cells - 1)
    return np.bincount(index, minlength=cells * cells).reshape(cells, cells)
