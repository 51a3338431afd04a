"""View of a task: positions to record, and pictures to draw them on."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]
"""[height, width, 3], its first row on top."""
Extent = tuple[float, float, float, float]
"""left, right, bottom and top of a picture, in the unit of the positions it shows"""


class View(Protocol):
    """A position (two numbers) for each state, and a picture to draw positions on.

    An environment offers its view as the attribute `view`; None, or no such attribute, means that
    there is nothing to show. Training records the positions, reports draw them; neither knows the
    task. A picture of positions is made from the bottom up: `background`, then heat
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
        """Return the positions of the states that were observed.

        observation: [..., observation size]; info: the arrays [...] that came with it -> [..., 2].
        """
        ...

    def places(self, positions: NDArray[np.floating]) -> list[str]:
        """Name the place of each position, [N, 2]: "corridor", "right rim"; [] without names."""
        ...

    def background(self, size: int) -> Picture:
        """Paint what lies below heat and trajectories: [size, size, 3]."""
        ...

    def overlay(self, picture: Picture) -> Picture:
        """Return the picture with what lies on top of heat and trajectories: outlines, marks."""
        ...


@runtime_checkable
class TellsWays(Protocol):
    """A view that also tells how agents came to the place where their episodes end."""

    def ways(self, positions: NDArray[np.floating], costs: NDArray[np.floating]) -> list[str]:
        """Name the way of each agent: "round", "through"; "" where there is nothing to tell.

        positions: [N, 2], where the episodes ended; costs: [N], of whole episodes.
        """
        ...
