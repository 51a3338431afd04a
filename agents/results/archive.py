"""Archives: folders of trainings as one zip file, with a row for each episode instead of each step.

Beside config.json and status.json a training has there, with names as in `training.derive`:

- `results.npz`: of each cost `costs/NAME/longest_streak`, `/cost_steps`, `/streaks` and, unless
  each cost step costs 1, `/cost`; returns of training's episodes to three digits; of the updates,
  which `epochs` numbers, the multipliers, at most `POINTS` of them; all else as it was
- `pictures.npz`: what a page draws. `trained/states`, `/positions` and `/unsafe`, a bit each: see
  `derive.Drawn`; `replay/drawn`, `/unsafe`, `/box` and `/steps`: see `results.reading.Highlights`;
  `visits` and `visited`
"""

from __future__ import annotations

import contextlib
import io
import re
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from agents.errors import UserError
from agents.results.reading import PICTURES, Group, Part, name_of_all
from agents.training.config import CONFIG, RESULTS, STATUS, RunId
from agents.training.derive import smallest, three_digits
from agents.training.files import UNREADABLE, whole, write_arrays
from emcc.records import records_of

POINTS = 500
"""Updates, at most, whose multipliers an archive keeps of a run: every one, every second, ..."""
OF_EPISODES = ("longest_streak", "cost_steps", "streaks")
MULTIPLIER = "multiplier"
"""Beginning of the names of the updates' numbers that an archive keeps."""
REPLACED = re.compile(r"(/return|/updates|/epochs|/costs/.*|/trained/.*|/replay/.*|/visit(s|ed))")
"""Ends of names below a run or a task that `results.npz` has in another form, or not."""


def write_archive(path: Path, groups: Sequence[Group]) -> None:
    """Pack the trainings of some groups into one file, whole or not at all."""
    parts = {part.folder: part for group in groups for part in group.parts}
    with whole(path) as target, zipfile.ZipFile(target, "w") as archive:
        archive.comment = name_of_all(groups).encode()
        for folder, part in sorted(parts.items()):
            prefix = "" if folder == "." else folder + "/"
            files = [name for name in (CONFIG, STATUS) if (part.path / name).is_file()]
            contents = {name: (part.path / name).read_bytes() for name in files}
            contents[RESULTS] = _npz(lean_results(part))
            if pictures := lean_pictures(part):
                contents[PICTURES] = _npz(pictures)
            for name, data in contents.items():
                archive.writestr(zipfile.ZipInfo(prefix + name), data)  # of a fixed date


def lean_results(part: Part) -> dict[str, NDArray]:
    """`results.npz` of an archive. A run that is damaged keeps its arrays as they are."""
    arrays, metrics = part.arrays, part.arrays.get("metrics", np.array([], dtype=np.str_))
    columns = [k for k, name in enumerate(metrics.tolist()) if name.startswith(MULTIPLIER)]
    kept: dict[str, NDArray] = {"metrics": metrics[columns]}
    runs = {run.prefix.removesuffix("/"): run for run in part.config.runs}
    damaged = []
    for prefix, run in runs.items():
        if f"{prefix}/length" in arrays:
            try:
                kept |= _of_run(part, run, columns)
            except UNREADABLE:
                damaged.append(prefix)
    for name in arrays:
        prefix = next((run for run in runs if name.startswith(run + "/")), name.partition("/")[0])
        if prefix in damaged or not REPLACED.fullmatch(name.removeprefix(prefix)):
            kept.setdefault(name, arrays[name])
    return kept


def _of_run(part: Part, run: RunId, columns: Sequence[int]) -> dict[str, NDArray]:
    """Episodes and multipliers of a run."""
    arrays, prefix = part.arrays, run.prefix
    kept: dict[str, NDArray] = {}
    for cost in part.config.costs:
        records = records_of(arrays, prefix, cost)
        for name in OF_EPISODES:
            kept[f"{prefix}costs/{cost}/{name}"] = smallest(getattr(records, name))
        if (records.cost != records.cost_steps).any():
            kept[f"{prefix}costs/{cost}/cost"] = records.cost
    returns = three_digits(arrays[prefix + "return"])
    fits = np.abs(returns).max(initial=0.0) < np.finfo(np.float32).max
    kept[prefix + "return"] = returns.astype(np.float32) if fits else returns
    if columns and prefix + "updates" in arrays:
        updates = arrays[prefix + "updates"][:, columns].astype(np.float32)
        epochs = arrays.get(prefix + "epochs", np.arange(len(updates), dtype=np.int32))
        every = max(1, -(-len(updates) // POINTS))
        kept |= {prefix + "updates": updates[::every], prefix + "epochs": epochs[::every]}
    return kept


def lean_pictures(part: Part) -> dict[str, NDArray]:
    """`pictures.npz` of an archive; a picture that is damaged is left out."""
    kept: dict[str, NDArray] = {}
    for task in part.config.tasks:
        for name in ("visits", "visited"):
            name = RunId(task, 0).prefix.removesuffix("0/") + name
            with contextlib.suppress(UserError, KeyError):
                kept[name] = part.pictures[name] if name in part.pictures else part.arrays[name]
    for run in part.config.runs:
        with contextlib.suppress(*UNREADABLE, UserError):
            kept |= _trained(part, run)
        with contextlib.suppress(*UNREADABLE, UserError):
            kept |= _replay(part, run)
    return kept


def _trained(part: Part, run: RunId) -> dict[str, NDArray]:
    if not (episodes := part.trained(run)):
        return {}
    positions, unsafe = zip(*episodes, strict=True)
    arrays: dict[str, NDArray] = {"states": smallest(np.array([*map(len, unsafe)]))}
    arrays |= {
        "positions": np.concatenate(positions),
        "unsafe": np.packbits(np.concatenate(unsafe)),
    }
    return {f"{run.prefix}trained/{name}": array for name, array in arrays.items()}


def _replay(part: Part, run: RunId) -> dict[str, NDArray]:
    if f"{run.prefix}length" not in part.arrays:
        return {}
    replay = part.replay(run, records_of(part.arrays, run.prefix, part.config.costs[0]))
    if replay is None:
        return {}
    points, unsafe = zip(*((e.points, e.unsafe) for e in replay.episodes), strict=True)
    arrays: dict[str, NDArray] = {"drawn": np.concatenate(points)}
    arrays |= {"unsafe": np.packbits(np.concatenate(unsafe)), "box": replay.box}
    arrays["steps"] = np.array(part.replay_steps(run))
    return {f"{run.prefix}replay/{name}": array for name, array in arrays.items()}


def _npz(arrays: Mapping[str, NDArray]) -> bytes:
    buffer = io.BytesIO()
    write_arrays(buffer, arrays, zipfile.ZIP_LZMA)
    return buffer.getvalue()
