"""Films of Circle2D with a scripted agent that moves around the cost region."""

from __future__ import annotations

from pathlib import Path

import gymnasium as gym
import numpy as np
from PIL import Image

from agents.reporting.pictures import Panel, film
from agents.results.groups import Episode

SIZE = 300
WAY = ((1.05, 0.6), (0.6, 1.1), (-0.6, 1.15), (-1.25, 0.5), (-1.15, 0.0), (-0.1, 0.0))
"""Places on the way into the corridor, in radii of the disc."""
NEAR = 0.15
"""Distance from a place, in radii, at which the agent aims at the next one."""


def episode(name: str, seed: int = 3) -> tuple[Episode, object]:
    """Play an episode with the scripted agent; return it and the view of the task."""
    env = gym.make(name)
    inner = env.unwrapped
    radius, full_step = inner.config.constraint_radius, inner.config.full_step
    env.reset(seed=seed)
    path, costs, way = [inner.position], [], list(WAY)
    over = False
    while not over:
        position = inner.position / radius
        while len(way) > 1 and np.hypot(*(np.array(way[0]) - position)) < NEAR:
            way.pop(0)
        aim = (np.array(way[0]) - position) * radius / full_step
        # At most a full action along either axis, in the direction of the aim.
        *_, terminated, truncated, info = env.step(aim / max(1.0, np.abs(aim).max()))
        path.append(inner.position)
        costs.append(info["cost"])
        over = terminated or truncated
    env.close()
    return Episode(np.array(path), np.array(costs)), inner.view


def write(name: str, path: Path) -> None:
    """Write the film of a task as a GIF."""
    played, view = episode(name)
    frames = [Image.fromarray(f) for f in film([Panel(name, view, [played])], SIZE)]
    few = [frame.quantize(96, dither=Image.Dither.NONE) for frame in frames]
    few[0].save(path, save_all=True, append_images=few[1:], duration=100, loop=0, optimize=True)
