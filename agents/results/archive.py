"""Archives: folders of trainings as one zip file, with a row for each episode instead of each step.

Beside config.json and status.json a training has there, with names as in `training.derive`:

- `results.npz`: of each cost `costs/NAME/kinds`, `/kind` and, unless each cost step costs 1,
  `/cost`; returns of training's episodes to three digits of the largest, `return` and
  `return/from`: see `emcc.records.records_of`; of a number that was recorded at each step what
  tables tell, `info/NAME/...`: see `results.recorded.packed`; of the updates, which `epochs`
  numbers, the multipliers, at most `POINTS` of them; all else as it was, evaluations among it
- `pictures.npz`: what a page draws. Of each task `visits`, as digits, and `visited`; of the first
  `DRAWN_POLICIES` runs of a task `trained` and `replay`, as they were

What is gone: costs and recorded numbers of single steps, so that no other threshold of a cost step
can be asked for; other numbers of the updates; checkpoints; the pictures of further runs. All
measures, with windows of any size too, are what they were.
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
"""Updates, at most, whose multipliers an archive keeps of a run: every one, every second, ..."""
OF_EPISODES = ("longest_streak", "cost_steps", "streaks")
"""Columns of `costs/NAME/kinds`."""
MULTIPLIER = "multiplier"
"""Beginning of the names of the updates' numbers that an archive keeps."""
REPLACED = re.compile(r"(/return|/updates|/epochs|/(costs|info|trained|replay)/.*|/visit(s|ed))")
"""Ends of names below a run or a task that `results.npz` has in another form, or not."""


def write_archive(path: Path, groups: Sequence[Group]) -> None:
    """Pack the trainings of some groups into one file, whole or not at all."""
    trainings = {training.folder: training for group in groups for training in group.trainings}
    with whole(path) as target, zipfile.ZipFile(target, "w") as archive:
        archive.comment = name_of_all(groups).encode()
        for folder, training in sorted(trainings.items()):
            prefix = "" if folder == "." else folder + "/"
            for name, data in _files(training).items():
                member = zipfile.ZipInfo(prefix + name)  # of a fixed date
                # As a whole: arrays of runs are alike, and so are the names of hundreds.
                archive.writestr(member, data, zipfile.ZIP_LZMA)


def _files(training: Training) -> dict[str, bytes]:
    """The files of a training in an archive; those of one that comes from an archive are kept."""
    is_packed = any(name.endswith("/return/from") for name in training.arrays)
    names = (CONFIG, STATUS, RESULTS, PICTURES) if is_packed else (CONFIG, STATUS)
    files = {n: (training.path / n).read_bytes() for n in names if (training.path / n).is_file()}
    if not is_packed:
        files[RESULTS] = _npz(lean_results(training))
        if pictures := lean_pictures(training):
            files[PICTURES] = _npz(pictures)
    return files


def lean_results(training: Training) -> dict[str, NDArray]:
    """`results.npz` of an archive. A run that is damaged keeps its arrays as they are."""
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
    """Episodes, recorded numbers and multipliers of a run."""
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
    """`pictures.npz` of an archive; a picture that is damaged is left out."""
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
