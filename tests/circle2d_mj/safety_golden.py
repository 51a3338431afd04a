"""Steps and models recorded from safety-gymnasium 1.0.0 (mujoco 2.3.3): tests/golden/suite.

Each .npz holds segments of episodes: arrays of constants are [segments, ...], of what steps gave
[segments, steps, ...], of states [segments, steps + 1, ...]. Entries from a segment's `length` on
are padding.
"""

import json
from pathlib import Path

import numpy as np

FOLDER = Path(__file__).parents[1] / "golden" / "suite"
CONSTANT = ("agent_body_pos0", "agent_body_quat0", "qpos0")
CONSTANT += ("hazards_pos", "pillars_pos", "buttons_pos")
STATE = ("qpos", "qvel", "time", "goal_pos", "mocap_pos", "goal_button", "timer")
STATE += ("torso_xpos", "mass_center")


class Step:
    """One recorded step."""

    def __init__(self, raw, segment, t):
        self._raw, self._segment, self._t = raw, segment, t
        self.first = raw["start"][segment] + t == 0

    def __contains__(self, name):
        return name in self._raw

    def state(self, after=False):
        """Return the state before or after the step, as `original.load` takes it."""
        raw, at = self._raw, (self._segment, self._t + after)
        constants = {name: raw[name][self._segment] for name in CONSTANT if name in raw}
        return constants | {name: raw[name][at] for name in STATE if name in raw}

    def __getitem__(self, name):
        """Return a value that the step gave."""
        return self._raw[name][self._segment, self._t]

    def seen(self):
        """Return the observation after the step."""
        return self._raw["obs"][self._segment, self._t + 1]


def recorded(task):
    """Return True if steps of the task were recorded: not of every level of the Doggo's tasks."""
    return (FOLDER / f"{task}.npz").exists()


def steps(task):
    """Return all recorded steps of a task; an absent cost is 0."""
    with np.load(FOLDER / f"{task}.npz") as file:
        raw = {name: np.nan_to_num(file[name]) for name in file}
    return [Step(raw, i, t) for i, length in enumerate(raw["length"]) for t in range(length)]


def parameters(task):
    return json.loads((FOLDER / f"{task}.model.json").read_text())
