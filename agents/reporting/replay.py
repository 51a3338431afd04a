"""Replay of training: the data of the page's player, for every run the episode of highest MCC in
each window of training, and the running EMCC.

Positions are on a grid of 1024 points along each side of the box of those shown, EMCC has three
digits; all else is exact. The page's script, `templates/replay.js`, reads it.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.errors import UserError
from agents.reporting.figures import emcc_along
from agents.reporting.maps import STATES, Scenes, shown_states
from agents.results.frame import in_order, name_of
from agents.results.reading import Group, Run
from agents.training.derive import GRID_MAX, WINDOWS, Replay
from agents.training.files import DamagedFile
from emcc.parts import ALPHA, PARTS

BITS = 10
"""Bits of a coordinate: the last of the grid's points along a side is 2**BITS - 1."""
DIGITS = 1000
"""EMCC is stored as a multiple of 1 / DIGITS."""


def replay_data(groups: Sequence[Group], scenes: Scenes, notes: list[str]) -> dict[str, Any]:
    """The data of the player; no runs where none has recorded positions and costs.

    What cannot be replayed of a task with positions goes into the notes.
    """
    runs = []
    for group in in_order(groups):
        scene = scenes.get(group, notes) if group.runs else None
        if scene is None:
            continue
        named = {"task": group.task, "algorithm": name_of(group)}
        for run in group.runs:
            try:
                replay = group.replay(run)
            except DamagedFile:
                raise
            except UserError as error:
                notes.append(f"no replay of {group.title}: {error}")
                break
            if not all(len(episode.points) for episode in replay.episodes):
                notes.append(f"no replay of {group.title}: it has no positions")
                break
            numbers = _run(run, replay, group.config.steps)
            runs.append({**named, "scene": scene.number, **numbers})
    extents = [list(scene.extent) for scene in scenes.all]
    return {
        "windows": WINDOWS,
        "bits": BITS,
        "digits": DIGITS,
        "states": STATES,
        "parts": list(PARTS),
        "extents": extents,
        "runs": runs,
    }


def _run(run: Run, replay: Replay, steps: int) -> dict[str, Any]:
    """One run's entry: numbers of each episode, then all points and all costs in a row."""
    episodes = replay.episodes
    points = [episode.points[shown_states(len(episode.points))] for episode in episodes]
    costs = np.concatenate([episode.costs for episode in episodes])
    lengths = {len(episode.costs) for episode in episodes}
    return {
        "seed": run.seed,
        "steps": steps,
        "box": replay.box.ravel().tolist(),
        "window": [episode.window for episode in episodes],
        "start": [episode.start_step for episode in episodes],
        # One number where all episodes are as long, none where cost steps cost 1.
        "length": lengths.pop() if len(lengths) == 1 else [len(e.costs) for e in episodes],
        "cost": [float(e.costs.sum()) for e in episodes] if set(costs) - {0.0, 1.0} else None,
        "points": _text(_packed(np.concatenate(points))),
        "unsafe": _text(np.packbits(costs > 0)),
        "emcc": [
            None if np.isnan(value) else round(value * DIGITS)
            for value in emcc_along(run.records, steps, ALPHA)
        ],
    }


def _packed(points: NDArray[np.uint16]) -> NDArray[np.uint8]:
    """Points [N, 2] on the coarser grid: x and y of one after another, `BITS` bits each."""
    coarse = np.round(points.astype(np.float64) * ((2**BITS - 1) / GRID_MAX)).astype(np.uint16)
    return np.packbits(coarse.reshape(-1, 1) >> np.arange(BITS)[::-1] & 1)


def _text(data: NDArray[np.uint8]) -> str:
    return base64.b64encode(data.tobytes()).decode()
