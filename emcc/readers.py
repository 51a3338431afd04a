"""Run folders and cost files -> what the table needs of each run."""

import json
import math
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from emcc.arrays import as_array, as_vector
from emcc.csv_columns import parse, read_columns
from emcc.records import COLUMNS, EpisodeRecords
from emcc.streaks import count_streaks, longest_streaks, streak_bounds

RECORDS_FILE = "episodes.csv"
CONFIG_FILE = "config.json"


@dataclass(frozen=True, eq=False)
class Run:
    """One training run: [D] MCC and start steps of its rollouts, and its sums."""

    path: Path
    mcc: NDArray[np.float64]
    start_steps: NDArray[np.int64]
    cost: float
    steps: int  # recorded
    total_steps: int  # planned, as far as known
    total_from: str = "recorded"
    task: str = ""
    algorithm: str = ""
    seed: str = ""
    settings: str = ""  # what else the runs of one experiment have in common


@dataclass(frozen=True, eq=False)
class EpisodeSums:
    """Episodes known by their sums only: [E] cost steps and lengths. They have no EMCC."""

    path: Path
    unsafe_steps: NDArray[np.int64]
    length: NDArray[np.int64]


def find_files(path: Path) -> list[Path]:
    """The file itself, or every episodes.csv below a folder.

    ValueError: neither exists.
    """
    if path.is_dir():
        files = sorted(path.rglob(RECORDS_FILE))
        if not files:
            raise ValueError(f"{path}: no {RECORDS_FILE} in this folder or below it")
        return files
    if not path.is_file():
        raise ValueError(f"{path}: no such file or folder")
    return [path]


def read(path: Path, threshold: float = 0.0) -> Run | EpisodeSums:
    """One file of records, of costs of steps (.npy, .npz, .csv) or of sums of episodes.

    threshold: for costs of steps; records hold streaks that were counted with their own.
    ValueError: a file that cannot be understood, named in the message.
    """
    if path.suffix in (".npy", ".npz"):
        return _read_numpy(path, threshold)
    columns = read_columns(path)
    if "longest_streak" in columns:
        if threshold != 0:
            raise ValueError(f"{path}: holds streaks, not costs of steps: leave the threshold out")
        return _labelled(_run_of_records(path, EpisodeRecords.load(path)))
    if "cost" in columns and "length" in columns:
        if threshold != 0:
            raise ValueError(f"{path}: holds sums, not costs of steps: leave the threshold out")
        return _read_sums(path, columns)
    if "cost" in columns:
        return _read_steps(path, columns, threshold)
    raise ValueError(
        f"{path}: has the columns {', '.join(columns)}; needed is cost (with episode and rollout, "
        f"if there are several), or {','.join(COLUMNS)}"
    )


def _labelled(run: Run) -> Run:
    """With task, algorithm, seed and the planned steps from the config.json beside the records."""
    path = run.path.parent / CONFIG_FILE
    if not path.is_file():
        return run
    try:
        config = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
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
        if not isinstance(steps, int) or steps < 1:
            raise ValueError(f"{path}: steps must be a whole number >= 1, got {steps!r}")
        labels |= {"total_steps": steps, "total_from": CONFIG_FILE}
    return replace(run, **labels)


def _run_of_records(path: Path, records: EpisodeRecords) -> Run:
    mcc, starts = records.mcc_per_rollout()
    steps = records.total_steps
    return Run(path, mcc, starts, float(records.cost.sum()), steps, steps)


def _run_of_costs(
    path: Path, costs: Any, lengths: Any, rollouts: Any = None, threshold: float = 0.0
) -> Run:
    """costs: [steps] of trajectories one after another; rollouts: id of each, default all apart."""
    try:
        longest = longest_streaks(costs, lengths, threshold)
        counts = count_streaks(costs, lengths, threshold)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: {error}") from None
    lengths = np.asarray(lengths).astype(np.int64)
    starts = np.cumsum(lengths) - lengths
    sums = np.add.reduceat(np.asarray(costs, dtype=np.float64), starts)
    ids = np.arange(len(lengths)) if rollouts is None else rollouts
    unknown_return = np.zeros(len(lengths))  # the table does not show it
    records = EpisodeRecords(ids, starts, lengths, unknown_return, sums, longest, *counts)
    return _run_of_records(path, records)


def _read_numpy(path: Path, threshold: float) -> Run:
    """.npy: costs [steps] or [episodes, steps]. .npz: costs, and lengths of several episodes."""
    try:
        content = np.load(path, allow_pickle=False)
        arrays = {"costs": content} if isinstance(content, np.ndarray) else dict(content)
    except (ValueError, EOFError, zipfile.BadZipFile) as error:
        raise ValueError(f"{path}: not a numpy file: {error}") from None
    if "costs" not in arrays:
        raise ValueError(f"{path}: has the arrays {', '.join(arrays)}; needed is costs")
    costs = np.atleast_1d(arrays["costs"])
    if "lengths" in arrays:
        return _run_of_costs(path, costs, arrays["lengths"], threshold=threshold)
    lengths = np.full(math.prod(costs.shape[:-1]), costs.shape[-1])
    return _run_of_costs(path, costs.ravel(), lengths, threshold=threshold)


def _read_steps(path: Path, columns: dict[str, list[str]], threshold: float) -> Run:
    """One row per step. A trajectory ends where the episode or the rollout changes."""
    costs = parse(path, columns, "cost", float)
    if not costs.size:
        raise ValueError(f"{path}: no steps")
    episode, rollout = (columns.get(name, [""] * costs.size) for name in ("episode", "rollout"))
    keys = list(zip(rollout, episode, strict=True))
    begins = [row for row, key in enumerate(keys) if row == 0 or key != keys[row - 1]]
    if len({keys[row] for row in begins}) < len(begins):
        raise ValueError(f"{path}: the steps of an episode must follow one another")
    lengths = np.diff([*begins, costs.size])
    names = [rollout[row] for row in begins]
    numbers = {name: number for number, name in enumerate(dict.fromkeys(names))}
    ids = np.array([numbers[name] for name in names]) if "rollout" in columns else None
    return _run_of_costs(path, costs, lengths, ids, threshold)


def _read_sums(path: Path, columns: dict[str, list[str]]) -> EpisodeSums:
    """One row per episode. The sum of its costs is its number of cost steps if they are 0/1."""
    cost, length = (parse(path, columns, name, float) for name in ("cost", "length"))
    try:
        streak_bounds(as_vector(cost, "cost"), length)
    except ValueError as error:
        raise ValueError(f"{path}: sums of 0/1 costs are needed for bounds: {error}") from None
    return EpisodeSums(path, as_array(cost, "cost").astype(int), length.astype(int))
