"""Views of the Safety-Gymnasium tasks: see `circle2d_mj.core.view.View`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from circle2d_mj.core.view import Extent, Picture
from circle2d_mj.render import canvas
from circle2d_mj.render.canvas import FINER, FREE, REGION
from circle2d_mj.safety import rules

_GOAL_COLOUR = (222, 238, 218)


class _MapView(ABC):
    """A view with a cost region and no named places."""

    extent: Extent
    axes: tuple[str, str]

    def places(self, positions: NDArray[np.floating]) -> list[str]:
        """Return nothing: no place has a name."""
        return []

    def background(self, size: int) -> Picture:
        """Paint the states that cost grey: [size, size, 3]."""
        costs = self._costs(canvas.points_of_pixels(self.extent, size))
        return np.where(costs[..., None], REGION, FREE).astype(np.uint8)

    def overlay(self, picture: Picture) -> Picture:
        """Add the outline of the states that cost."""
        return canvas.with_outline(picture, self._costs(self._fine_points(picture)))

    @abstractmethod
    def _costs(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Test whether states at positions [..., 2] cost: [...]."""

    def _fine_points(self, picture: Picture) -> NDArray[np.float64]:
        return canvas.points_of_pixels(self.extent, len(picture) * FINER)


class PointCircleView(_MapView):
    """The plane from above, with the circle; beyond the two walls states cost."""

    extent = (-2.5, 2.5, -2.5, 2.5)
    axes = ("x (m)", "y (m)")

    def positions(
        self, observation: NDArray[np.floating], info: Mapping[str, Any]
    ) -> NDArray[np.float64]:
        """Return the positions in the world: [..., 2] m."""
        return np.stack((info["x_position"], info["y_position"]), axis=-1)

    def overlay(self, picture: Picture) -> Picture:
        """Add the walls and the circle."""
        radius = np.linalg.norm(self._fine_points(picture), axis=-1)
        return canvas.with_outline(super().overlay(picture), radius < rules.CIRCLE_RADIUS)

    def _costs(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        return rules.circle_cost(points) > 0


class PointGoalView(_MapView):
    """Distance to the nearest hazard over distance to the goal.

    Goal and hazards lie elsewhere in each episode, so in a map of the world the visits of many
    episodes average out. These two distances are what reward and cost depend on: an episode runs
    from the right to the left, and it costs where it dips below the hazards' radius. Both come from
    the lidars; beyond their reach of 3 m a distance shows as 3 m.
    """

    extent = (0.0, 3.0, 0.0, 1.5)
    axes = ("to the goal (m)", "to the nearest hazard (m)")

    def positions(
        self, observation: NDArray[np.floating], info: Mapping[str, Any]
    ) -> NDArray[np.floating]:
        """Return the two distances: [..., 60] -> [..., 2] m."""
        goal, hazards, _ = np.split(np.asarray(observation)[..., -3 * rules.LIDAR_BINS :], 3, -1)
        nearest = np.stack((goal.max(axis=-1), hazards.max(axis=-1)), axis=-1)
        return rules.GOAL_LIDAR_REACH * (1.0 - nearest)

    def background(self, size: int) -> Picture:
        """Paint the states that cost grey, the others in which the goal is reached green."""
        points, picture = canvas.points_of_pixels(self.extent, size), super().background(size)
        reached = rules.goal_met(points[..., 0]) & ~self._costs(points)
        return np.where(reached[..., None], _GOAL_COLOUR, picture).astype(np.uint8)

    def overlay(self, picture: Picture) -> Picture:
        """Add the outline of the states that cost, and the axes."""
        ticks = ((0.5, 1, 1.5, 2, 2.5), (0.2, 0.5, 1))
        return canvas.with_ticks(super().overlay(picture), self.extent, self.axes, ticks)

    def _costs(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        return rules.goal_cost(points[..., 1:]) > 0


class HopperView(_MapView):
    """Height of the torso over its forward velocity; the velocities that cost are grey."""

    extent = (-1.5, 4.0, 0.6, 1.9)
    axes = ("forward velocity (m/s)", "height (m)")

    def positions(
        self, observation: NDArray[np.floating], info: Mapping[str, Any]
    ) -> NDArray[np.floating]:
        """Return velocity (the mean over the step) and height: [..., 2], m/s and m."""
        return np.stack((info["x_velocity"], observation[..., 0]), axis=-1)

    def overlay(self, picture: Picture) -> Picture:
        """Add the outline of the velocities that cost, and the axes."""
        ticks = ((-1, 0, 1, 2, 3), (0.7, 1, 1.3, 1.6))
        return canvas.with_ticks(super().overlay(picture), self.extent, self.axes, ticks)

    def _costs(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        return rules.hopper_cost(points[..., 0]) > 0
