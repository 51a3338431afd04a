"""Circle2D seen from above."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from circle2d_mj.circle2d import task
from circle2d_mj.circle2d.config import Circle2DConfig
from circle2d_mj.core.view import Extent, Picture

START, START_IN_REGION = (222, 238, 218), (166, 190, 160)
WALL = (90, 90, 90)
RING_SHADE = 0.75
"""Brightness of the circles of equal reward, relative to the picture below them."""


@dataclass(frozen=True)
class Circle2DView:
    """The arena with the agents' positions in world units: see `circle2d_mj.core.view.View`."""

    config: Circle2DConfig

    @property
    def extent(self) -> Extent:
        """The arena's edges in world units."""
        arena = self.config.arena
        return -arena, arena, -arena, arena

    @property
    def axes(self) -> tuple[str, str]:
        """Names of the two coordinates."""
        return "x (world units)", "y (world units)"

    def positions(
        self, observation: NDArray[np.floating], info: Mapping[str, Any]
    ) -> NDArray[np.float64]:
        """Return the observed positions: [..., 2 or 4] -> [..., 2] world units."""
        return task.position(self.config, observation)

    def places(self, positions: NDArray[np.floating]) -> list[str]:
        """Name the place of each position: see `CostRegion.places`."""
        return self.config.region.places(positions)

    def ways(self, positions: NDArray[np.floating], costs: NDArray[np.floating]) -> list[str]:
        """Tell how agents that ended in the corridor came there: "round" or "through".

        positions: [N, 2], where the episodes ended; costs: [N] -> N words, empty for agents that
        ended elsewhere, and for all if agents may start anywhere or cross the region at no cost.
        "through": at least as many cost steps as the crossing takes at full speed, see
        `CostRegion.crossing`. "round": fewer cost steps, or a rigid region; the agent surely went
        round to the corridor's open side.
        """
        config = self.config
        # An agent that crosses a distance in n + 1 steps ends n of them in the region.
        least = math.ceil(config.region.crossing() / config.full_step) - 1
        inner_end, ((left, _), _) = -config.region.cutouts[0].inner, config.start_rectangle
        if config.allow_infeasible_init or left < inner_end or least < 1:
            return [""] * len(positions)
        through = (np.asarray(costs) >= least) & bool(config.infeasible_region_penetratable)
        words = np.where(through, "through", "round")
        return np.where(np.array(self.places(positions)) == "corridor", words, "").tolist()

    def background(self, size: int) -> Picture:
        """Paint the cost region grey, with a dark rim if it is rigid, the start area green, and
        circles of equal reward every R/4 (in wide arenas R/2, R, ...): [size, size, 3]."""
        from PIL import Image

        from circle2d_mj.render import canvas

        config, fine = self.config, size * canvas.FINER
        points = canvas.points_of_pixels(self.extent, fine)
        x, y = points[..., 0], points[..., 1]
        inside = config.region.contains(points)
        (left, low), (right, high) = config.start_rectangle
        starts = (left <= x) & (x <= right) & (low <= y) & (y <= high)
        if not config.allow_infeasible_init:
            starts &= ~inside
        image = np.where(inside[..., None], canvas.REGION, canvas.FREE).astype(np.float64)
        image[starts] = np.where(inside[starts, None], START_IN_REGION, START)
        if not config.infeasible_region_penetratable:
            image[inside & ~canvas.eroded(inside, max(fine // 160, 1))] = WALL
        ring = config.constraint_radius / 4
        while ring * size < 16 * config.arena:  # circles closer than 8 pixels would merge
            ring *= 2
        distance = np.hypot(x - config.optima_perturbation[0], y - config.optima_perturbation[1])
        line = 0.6 * 2 * config.arena / size  # half of 1.2 pixels
        on_ring = np.abs(distance - ring * np.round(distance / ring)) < line
        image[on_ring] *= RING_SHADE
        return np.asarray(Image.fromarray(np.round(image).astype(np.uint8)).reduce(canvas.FINER))

    def overlay(self, picture: Picture) -> Picture:
        """Add the outline of the cost region, with corridor and cut-outs, and an X on the
        optimum."""
        from circle2d_mj.render import canvas

        outlined = canvas.with_outline(picture, _region(self.config, len(picture)))
        return canvas.with_cross(outlined, self.extent, self.config.optima_perturbation)


@lru_cache(maxsize=1)  # the same for all pictures of a film
def _region(config: Circle2DConfig, size: int) -> NDArray[np.bool_]:
    """Test whether the pixels of a picture `FINER` times as large lie in the cost region."""
    from circle2d_mj.render import canvas

    arena = config.arena
    points = canvas.points_of_pixels((-arena, arena, -arena, arena), size * canvas.FINER)
    return config.region.contains(points)
