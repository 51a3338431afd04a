"""Episodes and model parameters recorded from safety-gymnasium 1.0.0 (mujoco 2.3.3): tests/golden.

Each .npz holds 12 episodes of at most 200 steps, [12, 200, ...] for what a step gave and
[12, 201, ...] for states; steps at or beyond an episode's `length` hold nothing.
"""

import json
from pathlib import Path

import numpy as np

FOLDER = Path(__file__).parents[1] / "golden"


class Golden:
    """The recorded steps in one row each: `before(name)`, `after(name)`, `of_step(name)`."""

    def __init__(self, task):
        with np.load(FOLDER / f"{task}.npz") as file:
            self.raw = dict(file)
        self.during = np.arange(self.raw["reward"].shape[1]) < self.raw["length"][:, None]

    def before(self, name):
        return self.raw[name][:, :-1][self.during]

    def after(self, name):
        return self.raw[name][:, 1:][self.during]

    def of_step(self, name):
        return self.raw[name][self.during]

    def of_episode(self, name):
        """Constants of an episode, repeated for each of its steps."""
        steps = self.during.shape[1]
        return np.repeat(self.raw[name][:, None], steps, axis=1)[self.during]


def world(golden, when):
    """The Point agent's qpos and qvel in the world, [steps, 3] each.

    The original's joints act in the frame of the pose at the start: world xy = p0 + R(h0) qpos.
    """
    quat = golden.of_episode("agent_body_quat0")
    heading = 2 * np.arctan2(quat[:, 3], quat[:, 0])
    cos, sin = np.cos(heading), np.sin(heading)

    def turned(v):
        return np.stack((cos * v[:, 0] - sin * v[:, 1], sin * v[:, 0] + cos * v[:, 1]), axis=1)

    read = golden.before if when == "before" else golden.after
    qpos, qvel = read("qpos")[:, :3], read("qvel")[:, :3]
    position = golden.of_episode("agent_body_pos0")[:, :2] + turned(qpos)
    return (
        np.column_stack((position, heading + qpos[:, 2])),
        np.column_stack((turned(qvel), qvel[:, 2])),
    )


def parameters(task):
    return json.loads((FOLDER / f"{task}.model.json").read_text())
