"""Draw the films of Safety tasks in `docs/films`; needs EGL or OSMesa.

python docs/_ext/safety_films.py
"""

from __future__ import annotations

from pathlib import Path

import gymnasium as gym
import task_pages
from PIL import Image

import agents
import circle2d_mj
from agents.presets import is_circle2d
from agents.training.policy import load_policy

SIZE, PICTURES, HOLD = 240, 48, 8
"""Side of a picture in pixels, number of pictures, and steps from one picture to the next."""


def write(name: str, folder: Path) -> None:
    """Write the film of a task with `task_pages.shown_policy`, or without one with random actions,
    held for several steps each."""
    env = gym.make(name, render_mode="rgb_array")
    observation, _ = env.reset(seed=5)
    env.action_space.seed(2)
    shown = task_pages.shown_policy(name.rpartition("/")[2])
    policy = load_policy(shown) if shown else None
    frames = []
    hold = 2 if "Velocity" in name else HOLD  # a gait is faster than navigation
    for step in range(PICTURES * hold):
        if policy:
            action = policy(observation)
        elif step % (2 * hold) == 0:
            action = env.action_space.sample()
        observation, _, terminated, truncated, _ = env.step(action)
        if step % hold == 0:
            picture = Image.fromarray(env.render())
            frames.append(picture.resize((SIZE, SIZE), Image.Resampling.LANCZOS))
        if terminated or truncated:
            observation, _ = env.reset()
    env.close()
    path = folder / f"{name.rpartition('/')[2]}.gif"
    # A common palette: viewers mix up palettes of single frames.
    palette = frames[0].quantize(128, method=Image.Quantize.MAXCOVERAGE)  # rare colours, too
    frames = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    frames[0].save(path, save_all=True, append_images=frames[1:], duration=100, loop=0)


if __name__ == "__main__":
    gym.register_envs(circle2d_mj)
    of_zoo = [task for task in agents.zoo().task if not is_circle2d(task)]
    for task in {*task_pages.FILMED.values(), *of_zoo}:
        write(f"circle2d_mj/{task}", Path(__file__).parents[1] / "films")
