"""Films and pictures of trained policies, a panel for each run, side by side."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageOps

from agents.errors import UserError
from agents.reporting.figures import Ground
from agents.results.frames import Filmed
from agents.results.steps import Episode
from circle2d_mj.core.view import Picture, View
from circle2d_mj.render import canvas
from circle2d_mj.render.figure import figure
from emcc import longest_streak

AGENT = (200, 30, 30)
HELD = 8
"""Pictures for which an episode's last one stays."""


@dataclass(frozen=True)
class Panel:
    """Episodes of one policy, in the order in which a film shows them."""

    title: str
    view: View | None
    """None for episodes that the task itself draws."""
    episodes: Sequence[Episode | Filmed]


def picture(panels: Sequence[Panel], size: int) -> Picture:
    """All episodes of each panel in one picture, chains of cost steps boxed: [height, width, 3].

    size: pixels along each side of a panel. Raises UserError for a panel without a view.
    """
    drawn = []
    for panel in panels:
        if panel.view is None:
            raise UserError(
                f"the task of {panel.title!r} offers no view to draw whole episodes on: give --out "
                "a film, .gif or .mp4"
            )
        episodes = [episode for episode in panel.episodes if isinstance(episode, Episode)]
        ground = Ground(panel.view, panel.view.background(size))
        drawn.append(ground.trajectories(episodes, True))
    captions = [[f"mean cost {np.mean([e.costs.sum() for e in p.episodes]):.1f}" for p in panels]]
    return figure([drawn], [panel.title for panel in panels], captions=captions)


def film(panels: Sequence[Panel], size: int) -> Iterator[Picture]:
    """The episodes one after another, those of all panels at once: [height, width, 3] for each
    state, with the way that led there. An episode that is over waits for the others.

    size: pixels along each side of a panel; height and width are even, as video needs them.
    """
    grounds = [Ground(p.view, p.view.background(size)) if p.view else None for p in panels]
    for number, episodes in enumerate(zip(*(p.episodes for p in panels), strict=True), 1):
        for step in range(_length(episodes)):
            shown = [min(step, len(episode.costs)) for episode in episodes]
            drawn = [
                _state(ground, episode, k, size)
                for ground, episode, k in zip(grounds, episodes, shown, strict=True)
            ]
            words = [_words(number, e, k) for e, k in zip(episodes, shown, strict=True)]
            yield _even(figure([drawn], [panel.title for panel in panels], captions=[words]))


def few_colours(pictures: Iterator[Picture]) -> Iterator[Picture]:
    """The pictures of a film in the colours that a GIF holds well: it is then half as large."""
    for shown in pictures:
        few = Image.fromarray(shown).quantize(64, dither=Image.Dither.NONE)
        yield np.asarray(few.convert("RGB"))


def pictures_of(panels: Sequence[Panel]) -> int:
    """Number of pictures of a film."""
    return sum(map(_length, zip(*(panel.episodes for panel in panels), strict=True)))


def _length(episodes: Sequence[Episode | Filmed]) -> int:
    """Pictures of episodes that are shown at once."""
    return max(len(episode.costs) for episode in episodes) + 1 + HELD


def _words(number: int, episode: Episode | Filmed, steps: int) -> str:
    """Number, step, cost and longest streak of an episode after some steps."""
    costs = episode.costs[:steps]
    streak = longest_streak(costs) if steps else 0
    return f"episode {number}, step {steps}: cost {costs.sum():g}, longest streak {streak}"


def _state(ground: Ground | None, episode: Episode | Filmed, steps: int, size: int) -> Picture:
    """The task after some steps of an episode: the way there, and a disc where the agent is; or the
    task's own frame in the middle of the panel."""
    if isinstance(episode, Filmed):
        with Image.open(io.BytesIO(episode.frames[steps])) as frame:
            return np.asarray(ImageOps.pad(frame, (size, size), color=(255, 255, 255)))
    assert ground is not None
    view, path = ground.view, episode.positions
    way, costs = path[: steps + 1], episode.costs[:steps]
    painted = canvas.with_trajectories(ground.background, view.extent, [way], [costs])
    return _with_agent(view.overlay(painted), view, path[steps])


def _with_agent(picture: Picture, view: View, position: NDArray[np.floating]) -> Picture:
    """The picture with a disc where the agent is."""
    image, radius = Image.fromarray(picture), max(len(picture) / 60, 2.5)
    column, row = canvas.pixels(view.extent, position, len(picture))
    corners = (column - radius, row - radius, column + radius, row + radius)
    ImageDraw.Draw(image).ellipse(corners, fill=AGENT, outline=(255, 255, 255))
    return np.asarray(image)


def _even(picture: Picture) -> Picture:
    """The picture without its last row and column where their number is odd."""
    height, width, _ = picture.shape
    return picture[: height - height % 2, : width - width % 2]
