"""Films of MuJoCo's own frames; they are in the repository, since drawing them needs OpenGL."""

from __future__ import annotations

from pathlib import Path

import gymnasium as gym
import numpy as np
from PIL import Image

import circle2d_mj  # noqa: F401, registers the tasks

FILMS = Path(__file__).parents[1] / "films"
PRESSED = {
    "Circle2DMuJoCo-0-v0": {"camera": "top"},
    "Circle2DMuJoCo-1-v0": {"camera": "follow", "contact": "soft", "stiffness": 200},
}
SIZE, STEPS = 320, 30


def frames(task: str, **parameters: object) -> list[Image.Image]:
    """Return frames of an agent that presses against the region, slides along it, and lets go."""
    env = gym.make(task, render_mode="rgb_array", **parameters)
    env.reset(seed=3)
    drawn = []
    for t in range(STEPS):
        drawn.append(Image.fromarray(np.asarray(env.render())).resize((SIZE, SIZE)))
        env.step([-1.0, 0.0] if t < 12 else [-0.8, 0.9] if t < 22 else [0.6, 0.3])
    env.close()
    return [frame.quantize(96, dither=Image.Dither.NONE) for frame in drawn]


if __name__ == "__main__":
    for name, parameters in PRESSED.items():
        first, *others = frames(name, **parameters)
        path = FILMS / f"{name}-force.gif"
        first.save(path, save_all=True, append_images=others, duration=100, loop=0, optimize=True)
