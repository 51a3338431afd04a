"""Views of the Safety-Gymnasium tasks: see `circle2d_mj.core.view.View`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from circle2d_mj.core.view import Extent, Picture, View
from circle2d_mj.render import canvas
from circle2d_mj.render.canvas import FINER, FREE, REGION
from circle2d_mj.safety import rules
from circle2d_mj.safety.scenes import Scene

Ticks = tuple[tuple[float, ...], tuple[float, ...]]
"""Numbers on the axes of a picture: along the lower and the left edge."""
_GOAL_COLOUR = (222, 238, 218)


class _MapView(ABC):
    """A view with a cost region and no named places."""

    extent: Extent
    axes: tuple[str, str]
    _ticks: Ticks

    def places(self, positions: NDArray[np.floating]) -> list[str]:
        """Return nothing: no place has a name."""
        return []

    def background(self, size: int) -> Picture:
        """Paint the states that cost grey: [size, size, 3]."""
        costs = self._costs(canvas.points_of_pixels(self.extent, size))
        return np.where(costs[..., None], REGION, FREE).astype(np.uint8)

    def overlay(self, picture: Picture) -> Picture:
        """Add the outline of the states that cost, and the axes."""
        outlined = canvas.with_outline(picture, self._costs(self._fine_points(picture)))
        return canvas.with_ticks(outlined, self.extent, self.axes, self._ticks)

    @abstractmethod
    def _costs(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Test whether states at positions [..., 2] cost: [...]."""

    def _fine_points(self, picture: Picture) -> NDArray[np.float64]:
        return canvas.points_of_pixels(self.extent, len(picture) * FINER)


class MapView(_MapView):
    """The plane from above; states beyond the walls cost."""

    axes = ("x (m)", "y (m)")

    def __init__(
        self, extent: Extent, ticks: Ticks, walls: tuple[float, ...], circle: float
    ) -> None:
        self.extent, self._ticks, self._walls, self._circle = extent, ticks, walls, circle

    def positions(
        self, observation: NDArray[np.floating], info: Mapping[str, Any]
    ) -> NDArray[np.float64]:
        """Return the positions in the world: [..., 2] m."""
        return np.stack((info["x_position"], info["y_position"]), axis=-1)

    def overlay(self, picture: Picture) -> Picture:
        """Add the circle if there is one, the walls and the axes."""
        if self._circle:
            radius = np.linalg.norm(self._fine_points(picture), axis=-1)
            picture = canvas.with_outline(picture, radius < self._circle)
        return super().overlay(picture)

    def _costs(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        return rules.boundary_cost(points, self._walls) > 0


class DistanceView(_MapView):
    """Distance to the nearest hazard over distance to the target, the goal or the box.

    Targets and hazards lie elsewhere in each episode, so in a map of the world the visits of many
    episodes average out. Reward and cost depend on these two distances: an episode runs from right
    to left, and steps cost when it dips below the hazards' radius. Both distances come from the
    lidars, whose first numbers in the observation are at `target` and `hazards`; a distance beyond
    their reach of 3 m shows as 3 m.
    """

    extent = (0.0, 3.0, 0.0, 1.5)

    def __init__(self, name: str, target: int, hazards: int, radius: float, met: bool) -> None:
        self.axes = (f"to the {name} (m)", "to the nearest hazard (m)")
        self._ticks = ((0.5, 1, 1.5, 2, 2.5), (radius, 0.5, 1))
        self._first, self._radius, self._met = (target, hazards), radius, met

    def positions(
        self, observation: NDArray[np.floating], info: Mapping[str, Any]
    ) -> NDArray[np.floating]:
        """Return the two distances: [..., observation size] -> [..., 2] m."""
        seen = np.asarray(observation)
        nearest = [seen[..., k : k + rules.LIDAR_BINS].max(axis=-1) for k in self._first]
        return 3.0 * (1.0 - np.stack(nearest, axis=-1))

    def background(self, size: int) -> Picture:
        """Paint states that cost grey, and other states in which the goal is reached green."""
        points, picture = canvas.points_of_pixels(self.extent, size), super().background(size)
        reached = rules.goal_met(points[..., 0]) & ~self._costs(points) & self._met
        return np.where(reached[..., None], _GOAL_COLOUR, picture).astype(np.uint8)

    def _costs(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        return rules.hazard_cost(points[..., 1:], self._radius) > 0


class SpeedView(_MapView):
    """The observation's first number, a height or an angle, over speed; speeds that cost are
    grey."""

    def __init__(self, extent: Extent, name: str, limit: float, ticks: Ticks, planar: bool) -> None:
        self.extent, self._limit, self._ticks, self._planar = extent, limit, ticks, planar
        self.axes = ("forward velocity (m/s)" if planar else "speed (m/s)", name)

    def positions(
        self, observation: NDArray[np.floating], info: Mapping[str, Any]
    ) -> NDArray[np.floating]:
        """Return speed (the mean over the step) and the first number: [..., 2]."""
        speed = info["x_velocity"]
        if not self._planar:
            speed = np.hypot(speed, info["y_velocity"])
        return np.stack((speed, observation[..., 0]), axis=-1)

    def _costs(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        return rules.velocity_cost(points[..., 0], self._limit) > 0


_FROM_ABOVE: dict[str, tuple[Extent, Ticks, float]] = {
    "Circle": ((-2.5, 2.5, -2.5, 2.5), ((-2, -1, 0, 1), (-2, -1, 0, 1, 2)), rules.CIRCLE_RADIUS),
    "Run": ((-1.5, 1.5, -17.5, 17.5), ((-1, -0.5, 0, 0.5), (-15, -10, -5, 0, 5, 10)), 0.0),
}
_HEIGHTS = ((-1.0, 0.0, 1.0, 2.0, 3.0), (0.7, 1.0, 1.3, 1.6))
_SPEEDS: dict[str, tuple[Extent, str, Ticks]] = {
    "HalfCheetah": ((-2.0, 8.0, -0.8, 0.4), "height (m)", ((0, 2, 4, 6), (-0.4, 0))),
    "Hopper": ((-1.5, 4.0, 0.6, 1.9), "height (m)", _HEIGHTS),
    "Swimmer": ((-0.6, 0.6, -3.2, 3.2), "angle (rad)", ((-0.4, 0, 0.4), (-2, 0, 2))),
    "Walker2d": ((-1.5, 6.0, 0.7, 1.9), "height (m)", ((0, 2, 4), (1, 1.3, 1.6))),
    "Ant": ((0.0, 6.0, 0.1, 1.1), "height (m)", ((1, 2, 3, 4, 5), (0.2, 0.5, 0.8))),
    "Humanoid": ((0.0, 4.0, 0.9, 2.1), "height (m)", ((1, 2, 3), (1, 1.3, 1.6))),
}


def of_scene(family: str, scene: Scene, radius: float, sensors: int) -> View | None:
    """Return the view of a scene; None if there are no hazards or walls to show.

    radius: of the hazards, m; sensors: how many numbers precede the lidars in the observation.
    """
    if family in _FROM_ABOVE:
        extent, ticks, circle = _FROM_ABOVE[family]
        return MapView(extent, ticks, scene.walls, circle)
    target = "push_box" if family == "Push" else "goal"
    if not {"hazards", target} <= set(scene.lidars):
        return None
    first = {kind: sensors + rules.LIDAR_BINS * i for i, kind in enumerate(scene.lidars)}
    name = "box" if family == "Push" else "goal"
    return DistanceView(name, first[target], first["hazards"], radius, met=family == "Goal")


def of_body(body: str, limit: float, planar: bool) -> View:
    """Return the view of a body with a speed limit, m/s."""
    extent, name, ticks = _SPEEDS[body]
    return SpeedView(extent, name, limit, ticks, planar)
