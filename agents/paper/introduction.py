"""Introduction to a report on Circle2D: its levels, and why EMCC is not a cost."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from agents.reporting.figures import Figure
from agents.reporting.maps import Ground, png
from agents.results.reading import Episode
from circle2d_mj import Circle2DConfig
from circle2d_mj.circle2d import task
from circle2d_mj.circle2d.config import LEVELS
from circle2d_mj.circle2d.envs import MAX_EPISODE_STEPS
from circle2d_mj.circle2d.task import Kinematic
from circle2d_mj.circle2d.view import Circle2DView
from circle2d_mj.core.view import Picture
from circle2d_mj.render import canvas
from circle2d_mj.render.figure import figure, labelled
from emcc import cost_rate, emcc, longest_streak, mcc

Point = tuple[float, float]
SIZE = 320
"""Pixels along the side of a picture."""

LEVEL_TITLES = {
    0: "Level 0: cannot be entered",
    1: "Level 1: can be, at a cost",
    2: "Level 2: two more cut-outs",
    3: "Level 3: four more",
}
LABELS: dict[str, tuple[int, Sequence[Point]]] = {
    "start": (0, [(1.25, 0)]),
    "goal": (0, [(0.24, 0)]),
    "corridor": (0, [(-0.54, 0)]),
    "cost region": (0, [(0, -0.38)]),
    "cut-out": (2, [(0, 1.12), (0, -1.12)]),
    " cut-out": (3, [(1.0, 0.93), (1.0, -0.93)]),
}
"""Words in a picture of a level: from which level on, and where, in multiples of the radius."""


def introduction() -> list[Figure]:
    """The tasks and the metric, which are the same in every report on Circle2D."""
    picture, about_trajectories = two_trajectories(SIZE)
    return [
        Figure("levels", "png", png(levels(SIZE)), "The four levels", about_levels()),
        Figure("trajectories", "png", png(picture), "Why EMCC", about_trajectories),
    ]


def levels(size: int) -> Picture:
    """The tasks as they are registered, side by side, with names for what they consist of.

    size: pixels along the side of each. Source: the figure of the levels.
    """
    pictures = []
    for level in LEVELS:
        config = Circle2DConfig(level=level)
        view = Circle2DView(config)
        labels = []
        for name, (first, places) in LABELS.items():
            for place in places if level >= first else ():
                point = np.array(place) * config.constraint_radius
                at = canvas.pixels(view.extent, point, size)
                labels.append((name.strip(), *at.tolist()))
        pictures.append(labelled(view.overlay(view.background(size)), labels))
    return figure([pictures], [LEVEL_TITLES[level] for level in LEVELS])


def about_levels() -> str:
    """The caption of `levels`."""
    config = Circle2DConfig()
    return (
        "Seen from above; the agent starts in the green area and is rewarded for being near the "
        "goal, the X. Grey: the cost region, where a step costs 1 and which level 0 does not let "
        f"in; its radius is {config.constraint_radius:g}, the arena {2 * config.arena:g} wide and "
        f"high, a step at most {config.full_step:g} along each axis. Circles: equal "
        "reward, a quarter of the radius apart."
    )


def _round_the_rim(*at: Point) -> list[Point]:
    """Points at distances from the centre, in multiples of the radius, and angles in degrees."""
    return [(r * math.cos(math.radians(a)), r * math.sin(math.radians(a))) for r, a in at]


START, END = (1.3, 0.12), (-0.12, 0.03)
# Four times into the region and out again, and through the corridor.
OUT, IN = 1.06, 0.97
ALONG_THE_RIM = _round_the_rim(
    (OUT, 32), (IN, 46), (OUT, 60), (IN, 78), (OUT, 96), (IN, 114), (OUT, 132), (IN, 148)
)
ROUTES: dict[str, list[Point]] = {
    "One long violation": [START, END],
    "Several short ones": [START, *ALONG_THE_RIM, (-OUT, 0.36), (-0.98, 0.05), END],
}
"""Two ways to the goal, in multiples of the radius, with as many cost steps on either."""


def words(costs: NDArray[np.float64]) -> str:
    """Cost steps, longest chain and EMCC of an episode. Of a single rollout EMCC is its MCC."""
    return (
        f"{costs.sum():.0f} cost steps, longest chain {longest_streak(costs)}, "
        f"EMCC {emcc([mcc([costs])]):.2f}"
    )


def walk(config: Circle2DConfig, route: Sequence[Point]) -> Episode:
    """An episode that goes along a route and stays at its end, a full step at a time.

    route: the start, then where to go, in multiples of the radius.
    """
    points = np.array(route) * config.constraint_radius
    agent, reach = Kinematic(config, 1), config.full_step
    agent.place(np.array([0]), points[:1])
    path, costs, ahead = [points[0]], [], 1
    for _ in range(MAX_EPISODE_STEPS):
        way = points[ahead] - path[-1]
        distance = math.hypot(*way)
        contact, _ = agent.step(way[None] / max(distance, reach))
        costs.append(task.cost(config, agent.position, contact)[0])
        path.append(agent.position[0].copy())
        if distance <= reach:
            ahead = min(ahead + 1, len(points) - 1)
    return Episode(np.array(path), np.array(costs))


def two_trajectories(size: int) -> tuple[Picture, str]:
    """Two episodes of equal cost and different EMCC, and their caption.

    size: pixels along the side of each. Source: the figure of two trajectories.
    """
    config = Circle2DConfig(level=1)
    episodes = [walk(config, route) for route in ROUTES.values()]
    view = Circle2DView(config)
    ground = Ground(view, view.background(size))
    pictures = [ground.trajectories([episode], True) for episode in episodes]
    captions = [[words(costs) for _, costs in episodes]]
    picture = figure([pictures], list(ROUTES), captions=captions)
    rates = dict.fromkeys(f"{cost_rate(costs, [len(costs)]):.2f}" for _, costs in episodes)
    left, right = captions[0]
    return picture, (
        f"Two scripted episodes of {MAX_EPISODE_STEPS} steps on level 1, from the right to the "
        f"goal: a dot for each state, chains of consecutive cost steps in orange boxes. Left: "
        f"{left}. Right: {right}. The cost rate ({' and '.join(rates)}) does not tell them apart."
    )
