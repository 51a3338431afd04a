"""Run folders and cost files -> training runs, sums of episodes, means of epochs."""

import json
import math
import os
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from emcc import foreign_logs
from emcc.csv_columns import Columns, parse, read_columns
from emcc.files import read_checked
from emcc.inputs import EpisodeSums, EpochMeans, Run
from emcc.records import COLUMNS, EpisodeRecords, parse_records

RECORDS_FILE = "episodes.csv"
CONFIG_FILE = "config.json"
ENDS = ("done", "terminated", "truncated")
"""Columns that mark the last step of an episode, in files of costs of steps."""


def find_files(path: Path) -> list[Path]:
    """The file itself, or every episodes.csv below a folder; where there is none, every log of
    another library (`foreign_logs.FILES`).

    ValueError: neither exists.
    """
    if path.is_dir():
        for names in ((RECORDS_FILE,), foreign_logs.FILES):
            if files := sorted(file for name in names for file in path.rglob(name)):
                return files
        others = ", ".join(foreign_logs.FILES)
        raise ValueError(f"{path}: no {RECORDS_FILE} in this folder or below it, nor {others}")
    if not path.is_file():
        raise ValueError(f"{path}: no such file or folder")
    return [path]


def read(path: str | os.PathLike[str], threshold: float = 0.0) -> EpisodeRecords:
    """Records of one training run, from a file as `python -m emcc` reads it.

    path: what `EpisodeRecords.save` wrote; costs of steps in a .npy, .npz or .csv file; a .csv file
    with the cost, length and longest_streak of each episode; or a folder with one such file in it
    or below. `python -m emcc --help` names their columns.
    threshold: a step that costs more is a cost step; for costs of steps alone.
    A warning says where the file was read by a guess: one without episodes as one episode.
    Of a run that has not ended, give `emcc_by_part` the total_steps: records do not know them.
    ValueError: several files, one that cannot be understood, or one of sums of episodes or means
    of epochs, which have no EMCC.
    """
    files = find_files(Path(path))
    if len(files) > 1:
        shown = ", ".join(map(str, files[:3])) + (", ..." if len(files) > 3 else "")
        raise ValueError(f"{path}: one run is needed, but there are {len(files)}: {shown}")
    content = read_file(files[0], threshold)
    if not isinstance(content, Run):
        raise ValueError(f"{content.path}: {content.contents} cannot give EMCC")
    if content.note:
        warnings.warn(content.note, stacklevel=2)
    return content.records


def read_file(path: Path, threshold: float = 0.0) -> Run | EpisodeSums | EpochMeans:
    """One file of records, of costs of steps (.npy, .npz, .csv), of sums of episodes, or a log of
    another library.

    threshold: for costs of steps; records hold streaks that were counted with their own.
    ValueError: a file that cannot be understood, named in the message.
    """
    if path.suffix in (".npy", ".npz"):
        return _read_numpy(path, threshold)
    columns = read_columns(path)
    if "longest_streak" in columns:
        _no_threshold(path, threshold, "streaks")
        records = _read_records(columns)
        return _labelled(Run(path, records, records.total_steps))
    if foreign_logs.is_progress(columns):
        _no_threshold(path, threshold, "means of epochs")
        return foreign_logs.read_progress(columns)
    if foreign_logs.is_monitor(columns):
        _no_threshold(path, threshold, "sums")
        return foreign_logs.read_monitor(columns)
    if "cost" in columns and "length" in columns:
        _no_threshold(path, threshold, "sums")
        return foreign_logs.sums_of(columns, "cost", "length")
    if "cost" in columns:
        return _read_steps(columns, threshold)
    raise ValueError(
        f"{path}: has the columns {', '.join(columns)}; needed is cost (with episode and rollout, "
        f"or done, if there are several), or {','.join(COLUMNS)}"
    )


def _no_threshold(path: Path, threshold: float, contents: str) -> None:
    if threshold != 0:
        raise ValueError(
            f"{path}: holds {contents}, not costs of steps: leave the threshold out"
        )  # fmt: skip


def _read_records(columns: Columns) -> EpisodeRecords:
    """A file of `EpisodeRecords.save`; or one with cost, length and longest_streak of an episode in
    each row, in the order of training: each is a rollout, and without returns they are 0."""
    if not {"cost", "length"} <= columns.keys() or {"rollout", "start_step"} & columns.keys():
        return EpisodeRecords.load(columns.path)
    length = parse(columns, "length", int)
    steps = np.maximum(length, 1)  # a length below 1 is refused as such, not for a start step
    columns["rollout"] = [str(number) for number in range(len(length))]
    columns["start_step"] = [str(start) for start in np.cumsum(steps) - steps]
    columns.setdefault("return", ["0"] * len(length))
    return parse_records(columns)


def _labelled(run: Run) -> Run:
    """With task, algorithm, seed and the planned steps from the config.json beside the records."""
    path = run.path.parent / CONFIG_FILE
    if not path.is_file():
        return run
    try:
        config = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path}: not JSON: {error}") from None
    if not isinstance(config, dict):
        raise ValueError(f"{path}: must be a JSON object, got {type(config).__name__}")
    labels: dict[str, Any] = {
        key: str(config[key]) for key in ("task", "algorithm", "seed") if key in config
    }
    settings = {key: config[key] for key in ("hyperparameters", "task_parameters") if key in config}
    labels["settings"] = json.dumps(settings, sort_keys=True)
    if "steps" in config:
        steps = config["steps"]
        if not isinstance(steps, int) or isinstance(steps, bool) or not 1 <= steps < 2**63:
            raise ValueError(f"{path}: steps must be a whole number >= 1, got {steps!r}")
        labels |= {"total_steps": steps, "total_from": CONFIG_FILE}
    read_checked(path)
    return replace(run, **labels)


def _run_of_costs(
    path: Path, costs: Any, lengths: Any, rollouts: Any = None, threshold: float = 0.0
) -> Run:
    """costs: [steps] of trajectories one after another; rollouts: id of each, default all apart."""
    try:
        records = EpisodeRecords.from_costs(costs, lengths, None, rollouts, threshold)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: {error}") from None
    return Run(path, records, records.total_steps)


def _read_numpy(path: Path, threshold: float) -> Run:
    """.npy: costs [steps] or [episodes, steps]. .npz: costs, and lengths of several episodes."""
    try:
        with path.open("rb") as file, warnings.catch_warnings():  # numpy leaves a damaged file open
            warnings.simplefilter("error")  # of a damaged header too
            content: Any = np.load(file, allow_pickle=False)
            arrays = {"costs": content} if isinstance(content, np.ndarray) else dict(content)
    except OSError:
        raise
    except Exception as error:  # a damaged file has numpy and zipfile raise errors of any kind
        raise ValueError(f"{path}: not a numpy file: {error or type(error).__name__}") from None
    if "costs" not in arrays:
        raise ValueError(f"{path}: has the arrays {', '.join(arrays)}; needed is costs")
    not_read = [name for name in arrays if name.removesuffix("s") in ("episode", "rollout", *ENDS)]
    if not_read and "lengths" not in arrays:
        raise ValueError(
            f"{path}: the ends of episodes are not read from the array {', '.join(not_read)}: add "
            "the array lengths, or give costs the shape [episodes, steps]"
        )
    costs = np.atleast_1d(arrays["costs"])
    if costs.ndim > 2:
        raise ValueError(
            f"{path}: costs must be [steps] or [episodes, steps] of one run, got shape "
            f"{list(costs.shape)}"
        )
    if "lengths" in arrays:
        return _run_of_costs(path, costs, arrays["lengths"], threshold=threshold)
    lengths = np.full(math.prod(costs.shape[:-1]), costs.shape[-1])
    return _run_of_costs(path, costs.ravel(), lengths, threshold=threshold)


def _read_steps(columns: Columns, threshold: float) -> Run:
    """One row per step, of trajectories one after another."""
    path, costs = columns.path, parse(columns, "cost", float)
    if not costs.size:
        raise ValueError(f"{path}: no steps")
    keys = _trajectories(columns)
    begins = [row for row, key in enumerate(keys) if row == 0 or key != keys[row - 1]]
    if len({keys[row] for row in begins}) < len(begins):
        raise ValueError(f"{path}: the steps of an episode must follow one another")
    if len(begins) == costs.size > 1:
        raise ValueError(
            f"{path}: every episode has one row: these look like sums, which have no EMCC "
            "(with a column length they give bounds)"
        )
    lengths = np.diff([*begins, costs.size])
    names = [keys[row][0] for row in begins]
    numbers = {name: number for number, name in enumerate(dict.fromkeys(names))}
    ids = np.array([numbers[name] for name in names]) if "rollout" in columns else None
    run = _run_of_costs(path, costs, lengths, ids, threshold)
    if {"episode", "rollout", *ENDS} & columns.keys():
        return run
    return replace(run, note=f"{path} has no column episode or done: read as one episode.")


def _trajectories(columns: Columns) -> list[tuple[str, str]]:
    """Rollout and episode of each row. Without a column `episode`, one ends behind each row that
    one of `ENDS` marks. With both, an episode may end unmarked, as where it was reset or where
    `terminated` stands alone; but none goes on behind a mark."""
    rows, marks = len(columns["cost"]), [name for name in ENDS if name in columns]
    flags = [_flags(columns, name) for name in marks]
    last = np.any([np.zeros(rows, dtype=bool), *flags], axis=0)
    episode = columns.get("episode", list(map(str, np.cumsum(last) - last)))
    keys = list(zip(columns.get("rollout", [""] * rows), episode, strict=True))
    for row in np.flatnonzero(last[:-1]).tolist():
        if keys[row] == keys[row + 1]:
            raise ValueError(
                f"{columns.path}, line {columns.lines[row]}: the last step of an episode by "
                f"{', '.join(marks)}, but the next line has the episode {episode[row]!r} too"
            )
    return keys


def _flags(columns: Columns, name: str) -> NDArray[np.bool_]:
    """A column of 0 and 1, or of False and True: [rows]."""
    words = {"false": "0", "true": "1"}
    columns[name] = [words.get(text.lower(), text) for text in columns[name]]
    flags = parse(columns, name, float)
    if len(bad := np.flatnonzero((flags != 0) & (flags != 1))):
        place = f"{columns.path}, line {columns.lines[bad[0]]}, column {name}"
        raise ValueError(f"{place}: must be 0 or 1, got {flags[bad[0]]:g}")
    return flags == 1
