"""Archives: folders of trainings as one zip file, with a row for each episode instead of each step.

For each training an archive holds config.json, status.json and two files of arrays, which are named
as in `training.derive`:

- `results.npz`: for each cost `costs/NAME/kinds`, `/kind` and, unless every cost step costs 1,
  `/cost`; the returns of training episodes to three digits of the largest, in `return` and
  `return/from` (see `emcc.records.records_of`); for each number recorded at every step, what tables
  show, in `info/NAME/...` (see `results.recorded.packed`); the multipliers of at most `POINTS`
  updates, whose numbers are in `epochs`; everything else, evaluations included, unchanged
- `pictures.npz`: what a page draws: `visits`, as digits, and `visited` for each task; `trained` and
  `replay`, unchanged, for the first `DRAWN_POLICIES` runs of a task

An archive lacks the costs and recorded numbers of single steps, so cost steps cannot be counted
with another threshold; the other numbers of the updates; checkpoints; and the pictures of further
runs. All measures, with windows of any size too, keep their values.
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
from agents.results import recorded
from agents.results.groups import PICTURES, Group, Training, name_of_all
from agents.training.config import CONFIG, RESULTS, STATUS, RunId, file_name
from agents.training.derive import DRAWN_POLICIES, smallest, thousandths
from agents.training.files import UNREADABLE, whole, write_arrays
from emcc.records import digits, records_of

POINTS = 500
"""Most updates of a run whose multipliers an archive keeps: all updates, every second one, ..."""
OF_EPISODES = ("longest_streak", "cost_steps", "streaks")
"""Columns of `costs/NAME/kinds`."""
MULTIPLIER = "multiplier"
"""Prefix of the names of those metrics of the updates that an archive keeps."""
REPLACED = re.compile(r"(/return|/updates|/epochs|/(costs|info|trained|replay)/.*|/visit(s|ed))")
"""Ends of array names, below a run or task, that `results.npz` stores differently or not at all."""


def write_archive(path: Path, groups: Sequence[Group]) -> None:
    """Pack the trainings of the groups into one file; an error leaves no partial file."""
    trainings = {training.folder: training for group in groups for training in group.trainings}
    with whole(path) as target, zipfile.ZipFile(target, "w") as archive:
        archive.comment = name_of_all(groups).encode()
        for folder, training in sorted(trainings.items()):
            prefix = "" if folder == "." else folder + "/"
            for name, data in _files(training).items():
                member = zipfile.ZipInfo(prefix + name)  # with a fixed date
                # Compressed as one member: the arrays of runs are alike, and so are their names.
                archive.writestr(member, data, zipfile.ZIP_LZMA)


def _files(training: Training) -> dict[str, bytes]:
    """Return a training's files for an archive; a training read from one keeps its files."""
    is_packed = any(name.endswith("/return/from") for name in training.arrays)
    names = (CONFIG, STATUS, RESULTS, PICTURES) if is_packed else (CONFIG, STATUS)
    files = {n: (training.path / n).read_bytes() for n in names if (training.path / n).is_file()}
    if not is_packed:
        files[RESULTS] = _npz(lean_results(training))
        if pictures := lean_pictures(training):
            files[PICTURES] = _npz(pictures)
    return files


def lean_results(training: Training) -> dict[str, NDArray]:
    """Return the arrays of an archive's `results.npz`; a damaged run's arrays stay as they are."""
    arrays, metrics = training.arrays, training.arrays.get("metrics", np.array([], dtype=np.str_))
    columns = [k for k, name in enumerate(metrics.tolist()) if name.startswith(MULTIPLIER)]
    kept: dict[str, NDArray] = {"metrics": metrics[columns]}
    runs = {run.prefix.removesuffix("/"): run for run in training.config.runs}
    damaged = []
    for prefix, run in runs.items():
        if f"{prefix}/length" in arrays:
            try:
                kept |= _of_run(training, run, columns)
            except (*UNREADABLE, UserError):
                damaged.append(prefix)
    for name in arrays:
        prefix = next((run for run in runs if name.startswith(run + "/")), name.partition("/")[0])
        if prefix in damaged or not REPLACED.fullmatch(name.removeprefix(prefix)):
            kept.setdefault(name, arrays[name])
    return kept


def _of_run(training: Training, run: RunId, columns: Sequence[int]) -> dict[str, NDArray]:
    """Return the arrays that hold a run's episodes, recorded numbers and multipliers."""
    arrays, prefix = training.arrays, run.prefix
    kept: dict[str, NDArray] = {}
    for cost in training.config.costs:
        records = records_of(arrays, prefix, cost)
        rows = np.stack([getattr(records, name) for name in OF_EPISODES], axis=1)
        kinds, kind = np.unique(rows, axis=0, return_inverse=True)
        kept[f"{prefix}costs/{cost}/kinds"] = smallest(kinds)
        kept[f"{prefix}costs/{cost}/kind"] = digits(kind.ravel())
        if (records.cost != records.cost_steps).any():
            kept[f"{prefix}costs/{cost}/cost"] = records.cost
    numbers, scale = thousandths(arrays[prefix + "return"])
    lowest = numbers.min(initial=0)
    kept[prefix + "return"] = digits(numbers - lowest)
    kept[prefix + "return/from"] = np.array([lowest, scale])
    records = records_of(arrays, prefix, training.config.costs[0])
    for name, _ in arrays.get(file_name(run.task) + "/info", ()):
        if f"{prefix}info/{name}/steps" in arrays:
            values = training.of_steps(f"{prefix}info/{name}/", records.total_steps)
            found = recorded.packed(values, records).items()
            kept |= {f"{prefix}info/{name}/{key}": array for key, array in found}
    if columns and prefix + "updates" in arrays:
        updates = arrays[prefix + "updates"][:, columns].astype(np.float32)
        epochs = arrays.get(prefix + "epochs", np.arange(len(updates), dtype=np.int32))
        every = max(1, -(-len(updates) // POINTS))
        kept |= {prefix + "updates": updates[::every], prefix + "epochs": epochs[::every]}
    return kept


def lean_pictures(training: Training) -> dict[str, NDArray]:
    """Return the arrays of an archive's `pictures.npz`, without damaged pictures."""
    kept: dict[str, NDArray] = {}
    for task in training.config.tasks:
        prefix = file_name(task) + "/"
        with contextlib.suppress(UserError, KeyError):
            kept[prefix + "visits"] = digits(training.visits(prefix))
            kept[prefix + "visited"] = training.arrays[prefix + "visited"]
    first = training.config.seeds[:DRAWN_POLICIES]
    drawn = (run for run in training.config.runs if run.seed in first)
    for prefix in (run.prefix + picture for run in drawn for picture in ("trained/", "replay/")):
        with contextlib.suppress(*UNREADABLE, UserError):
            kept |= {k: training.arrays[k] for k in training.arrays if k.startswith(prefix)}
    return kept


def _npz(arrays: Mapping[str, NDArray]) -> bytes:
    buffer = io.BytesIO()
    write_arrays(buffer, arrays)
    return buffer.getvalue()
