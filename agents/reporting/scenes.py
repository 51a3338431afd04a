"""Tasks as drawn on the page: what all their pictures share, heat as an image, paths as SVG.

The picture below and the one on top are in the page once for each task; what lies between is an
image of a pixel for each cell, or a path. Paths are in thousandths of the picture's side.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from agents.errors import UserError
from agents.reporting.image_files import png
from agents.results.steps import Episode
from agents.training.config import TrainConfig
from agents.training.environments import view_of
from circle2d_mj.core.view import Extent, View
from circle2d_mj.render import canvas

SIZE = 360
"""Pixels along the side of the pictures below and on top."""
SIDE = 1000
"""Of a picture in the units of its paths."""
STATES = 128
"""Of an episode, at most, that are drawn: of a longer one every second, third, ... state."""
SHADES = 31
"""Of the heat."""


class Scene(NamedTuple):
    """The part that all pictures of one task share."""

    number: int
    """Its place among the page's."""
    extent: Extent
    """See `circle2d_mj.core.view.View`."""
    below: bytes
    """PNG."""
    above: bytes
    """PNG with transparency."""


class Scenes:
    """The scenes of tasks, each made when it is first asked for."""

    def __init__(self) -> None:
        self._found: dict[str, Scene | None] = {}

    def of(self, config: TrainConfig, notes: list[str]) -> Scene | None:
        """The scene of the task of some runs; None of a task without a view, and of one that cannot
        be made, which goes into the notes."""
        key = repr((config.task, config.task_parameters))
        if key not in self._found:
            self._found[key] = None
            try:
                view = view_of(config.task, config.task_parameters)
            except UserError as error:
                notes.append(f"no pictures of {config.task}: {error}")
            else:
                self._found[key] = None if view is None else _scene(len(self.all), view)
        return self._found[key]

    @property
    def all(self) -> list[Scene]:
        """Those that were asked for, by number."""
        return [scene for scene in self._found.values() if scene]


def _scene(number: int, view: View) -> Scene:
    # What lies on top covers light and dark alike, so their difference tells how much it covers.
    light, dark = (
        view.overlay(np.full((SIZE, SIZE, 3), shade, np.uint8)).astype(np.float64)
        for shade in (255, 0)
    )
    cover = 1.0 - np.clip(light - dark, 0, 255).mean(axis=-1, keepdims=True) / 255
    colour = np.clip(dark / np.maximum(cover, 1 / 255), 0, 255)
    above = np.concatenate((colour, 255 * cover), axis=-1).round().astype(np.uint8)
    return Scene(number, view.extent, png(view.background(SIZE)), png(above))


def heat_png(counts: NDArray[np.int64], most: int) -> bytes:
    """The heat of visits, a pixel for each cell; cells without a visit are transparent.

    counts: [cells, cells]; most: see `canvas.with_counts`.
    """
    shade = 1 + np.round(canvas.heat_share(counts, most) * (SHADES - 1))
    image = Image.fromarray(np.where(counts > 0, shade, 0).astype(np.uint8), "P")
    colours = canvas.heat_colours(np.linspace(0.0, 1.0, SHADES))
    image.putpalette([0, 0, 0, *colours.ravel().tolist()])
    file = io.BytesIO()
    image.save(file, "PNG", optimize=True, transparency=0)
    return file.getvalue()


def shown_states(steps: int) -> NDArray[np.int64]:
    """The states of an episode that are drawn: all of `STATES` or fewer, else every k-th, and the
    last.

    The page's script has the same rule.
    """
    every = -(-steps // STATES)
    return np.append(np.arange(0, steps - 1, every), steps - 1)


def paths(scene: Scene, episodes: Sequence[Episode]) -> tuple[str, str]:
    """SVG paths of episodes: their lines, a drawn state at each point; and a point for each drawn
    state that cost, or stands for one that did.

    A step's cost is that of the state it ends in.
    """
    ways, costly = [], []
    for positions, costs in episodes:
        at = shown_states(len(positions))
        points = _units(scene.extent, positions[at])
        ways.append(f"M{_line(points)}")
        # The start has no cost; the steps between two drawn states count for the later one.
        of_states = np.concatenate((np.zeros(len(positions) - len(costs)), costs)) > 0
        cost = np.logical_or.reduceat(of_states, np.concatenate(([0], at[:-1] + 1)))
        costly += [f"M{x} {y}h0" for x, y in points[cost].tolist()]
    return "".join(ways), "".join(costly)


def _units(extent: Extent, positions: ArrayLike) -> NDArray[np.int64]:
    return np.round(canvas.pixels(extent, positions, SIDE)).astype(np.int64)


def _line(points: NDArray[np.int64]) -> str:
    """Points as a path relative from one to the next, which takes half the letters."""
    (x, y), *steps = [points[0].tolist(), *np.diff(points, axis=0).tolist()]
    return f"{x} {y}l" + " ".join(f"{dx} {dy}" for dx, dy in steps) if steps else f"{x} {y}h0"
