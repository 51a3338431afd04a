"""Records from files of costs, run folders and archives, and from the data of other libraries.

Minari and TorchRL objects are used through their methods; neither library is imported.
"""

import json
import os
import re
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from emcc.arrays import as_array, as_count, named
from emcc.npz import open_zip, read_arrays
from emcc.recorder import CostRecorder
from emcc.records import EpisodeRecords, records_of
from emcc.table import Columns

ENDS = ("done", "terminated", "truncated")
"""Columns that mark the last step of an episode, in files with a row per step."""
KNOWN = ("cost", "reward", "episode", "rollout")
"""Further columns that are read from files with a row per step."""
ENVIRONMENT = re.compile(
    r"(n|num|idx|index|id)?v?(env|environment|worker|rank|process|proc|pid|actor|thread|runner"
    r"|instance|replica|copy|agent|sim|simulator)s?(n|no|nr|num|number|i|ix|idx|index|id|ids|name)?"
)
"""Names, reduced to lower-case letters, of columns that identify environments, whose steps may be
interleaved. `_environments` also finds other columns, by their values."""
STEP = re.compile(r"(n|num|global|total|env|time)?(time)?steps?|t")
"""Names, likewise reduced, of columns that count steps, which increase within an episode."""
RUN = re.compile(r"(seed|run|algo|algorithm|experiment)s?(n|no|nr|num|number|idx|index|id|name)?")
"""Names, likewise reduced, of columns that identify runs: see `_runs`."""
WHOLE = re.compile(r"\d+(\.0*)?")


@dataclass(frozen=True, eq=False)
class Run:
    """The training costs of one run."""

    source: str
    """The file, or the run folder."""
    records: EpisodeRecords
    total_steps: int
    """Environment steps of the whole training."""
    task: str = ""
    algorithm: str = ""
    seed: str = ""
    cost: str = "cost"
    """Name of the cost in the environment's info."""
    episodes: EpisodeRecords | None = None
    """Records of whole episodes, if rollouts cut the episodes in `records`."""
    failure: str = ""
    """Why the training failed before its end; empty if it did not."""

    @property
    def whole(self) -> EpisodeRecords:
        """Records of whole episodes, whether or not rollouts cut them."""
        return self.records if self.episodes is None else self.episodes

    @property
    def incomplete(self) -> str:
        """Why the run is left out of means; empty for a complete run."""
        return self.failure or ("" if len(self.records) else "no finished trajectory")


def read(
    path: str | os.PathLike[str],
    threshold: float = 0.0,
    cost: str | None = None,
    *,
    episodes: bool = False,
) -> EpisodeRecords:
    """Read the records of one training run, from a file or run folder as `python -m emcc` does.

    threshold: a step whose cost exceeds it is a cost step.
    cost: name of the cost, for a run with several; by default the first.
    episodes: return whole episodes, where the column `rollout` of a file cuts them into pieces: for
    windows of episodes, and for `panel(..., episodes=read(path, episodes=True))`.
    ValueError: several runs, a run whose training failed before its end, no cost of that name,
    content that cannot be understood, or a threshold for a file with a row per episode, which has
    streaks instead of the cost of each step.
    """
    runs = read_runs(Path(path), threshold)
    names = dict.fromkeys(run.cost for run in runs)
    if cost not in (None, *names):
        there = ", ".join(filter(None, names)) or "one without a name"
        raise ValueError(f"{path}: there is no cost {cost!r}; its costs: {there}")
    runs = [run for run in runs if run.cost == (cost or runs[0].cost)]
    if len(runs) > 1:
        raise ValueError(f"{path}: one run is needed, but there are {len(runs)}")
    if runs[0].failure:  # thirds of the recorded steps are not thirds of the training
        raise ValueError(f"{path}: {runs[0].failure}")
    return runs[0].whole if episodes else runs[0].records


def read_runs(path: Path, threshold: float = 0.0) -> list[Run]:
    """Read all runs of a file of costs, a run folder, an archive, or a folder that holds some.

    ValueError: content that cannot be understood, naming its path.
    """
    if path.is_dir() or path.suffix == ".zip":
        with named(path):
            folder = zipfile.Path(open_zip(path)) if path.is_file() else path
        runs = [run for inner in _run_folders(folder) for run in _read_run_folder(inner, threshold)]
        if not runs:
            raise ValueError(f"{path}: no run folder (config.json, results.npz) in it or below")
        return runs
    if not path.is_file():
        raise ValueError(f"{path}: no such file or folder")
    with named(path):
        if path.suffix in (".npy", ".npz"):
            arrays = _one_name(dict(_arrays(path)), "cost", "costs")
            arrays = _one_name(arrays, "reward", "rewards")
            if others := sorted({*arrays} - {"costs", "lengths", "rewards", "rollouts"}):
                known = "must have costs, and may have lengths, rewards and rollouts"
                raise ValueError(f"has unknown arrays, {', '.join(others)}: a file {known}")
            records, episodes = EpisodeRecords.from_costs(**arrays, threshold=threshold), None
        else:
            records, episodes = _read_csv(path, threshold)
    return [Run(str(path), records, records.total_steps, episodes=episodes)]


def _run_folders(folder: Any) -> Iterator[Any]:
    """Yield the run folders in a folder or below, by name; folder: pathlib.Path or zipfile.Path."""
    if (folder / "config.json").is_file():
        yield folder
        return
    for inner in sorted(folder.iterdir(), key=lambda entry: entry.name):
        if inner.is_dir():
            yield from _run_folders(inner)


def _read_run_folder(folder: Any, threshold: float) -> Iterator[Run]:
    """Yield the runs of one training: for each task and seed in config.json, whose arrays are
    TASK/SEED/* in results.npz, a run for each cost."""
    with named(folder / "config.json"):
        config = json.loads((folder / "config.json").read_text(encoding="utf-8"))
        algorithm, steps = config["algorithm"], as_count(config["steps"], "steps")
        if not isinstance(algorithm, str):
            raise ValueError(f"algorithm must be a name, got {algorithm!r}")
        costs = config.get("costs", ["cost"])
        keys = [(task, str(seed)) for task in config["tasks"] for seed in config["seeds"]]
    results = folder / "results.npz"
    if not results.is_file():
        raise ValueError(f"{folder}: no results.npz, which a training writes at its end")
    with named(results):
        arrays = _arrays(results)
    for task, seed in keys:
        prefix = f"{re.sub('[/:]', '-', task)}/{seed}/"
        for cost in costs:
            with named(results):
                failure = str(arrays[prefix + "failure"]) if prefix + "failure" in arrays else ""
                if failure and prefix + "length" not in arrays:  # failed in the first epoch
                    records = CostRecorder(1).records
                else:
                    records = records_of(arrays, prefix, cost, threshold)
            about = (task, algorithm, seed, cost)
            total = max(steps, records.total_steps)  # whole epochs may take more steps than asked
            yield Run(str(folder), records, total, *about, failure=failure)


def _arrays(path: Any) -> Any:
    """Read the arrays of a NumPy file, by name; path: pathlib.Path or zipfile.Path."""
    content = read_arrays(path.read_bytes())
    return {"costs": content} if isinstance(content, np.ndarray) else content


def _one_name(columns: Any, other: str, name: str) -> Any:
    """Rename the column or array `other` to `name`: files may use the singular or the plural of
    cost and reward. ValueError: both are present."""
    if other in columns and name in columns:
        raise ValueError(f"has both {name} and {other}: keep one of them")
    if other in columns:
        columns[name] = columns.pop(other)
    return columns


def _read_csv(path: Path, threshold: float) -> tuple[EpisodeRecords, EpisodeRecords | None]:
    """Read a CSV file of records, or with the cost of a step in each row. Return the records, and
    those of whole episodes if rollouts cut episodes."""
    columns = _one_name(_one_name(Columns(path), "costs", "cost"), "rewards", "reward")
    if "longest_streak" in columns:
        if threshold:
            raise ValueError("holds streaks, not costs of steps: leave the threshold out")
        return EpisodeRecords._from_columns(columns), None
    marks = [name for name in ENDS if name in columns]
    if "cost" not in columns or not (marks or "episode" in columns):
        raise ValueError(
            f"has the columns {', '.join(columns)}. EMCC needs a row for each step, with cost and "
            f"one of episode, {', '.join(ENDS)}; or a row for each episode, with length, cost and "
            "longest_streak. Sums over episodes and means over epochs cannot give EMCC"
        )
    costs = columns.numbers("cost", float)
    if not costs.size:
        raise ValueError("no steps")
    rewards = columns.numbers("reward", float) if "reward" in columns else None
    # An episode ends where its number changes and after a marked step; a rollout may cut it.
    rollouts, episodes = (columns.get(name, [""] * costs.size) for name in ("rollout", "episode"))
    cuts, ends = (np.array([a != b for a, b in pairwise([*x, None])]) for x in (rollouts, episodes))
    marked = _marked(columns, marks)
    if name := _runs(columns, ends | marked):
        raise ValueError(f"has several runs in the column {name}: write a file for each run")
    if name := _environments(columns, cuts | ends | marked):
        raise ValueError(
            f"has several environments in the column {name}: write whole episodes in the order in "
            "which they ended, with a different number for each in the column episode, and leave "
            f"out the column {name}"
        )
    if name := _not_rising(columns, cuts | ends | marked):
        raise ValueError(
            f"the column {name} does not rise within an episode: steps of several environments are "
            "interleaved, or the end of an episode is not marked; write whole episodes in the "
            "order in which they ended, with a different number for each in the column episode"
        )
    if len(set(rollouts)) < cuts.sum():
        raise ValueError("the steps of a rollout must be consecutive rows")
    if "episode" in columns and len({*zip(rollouts, episodes, strict=True)}) < (cuts | ends).sum():
        raise ValueError("the steps of an episode must be consecutive rows")
    ends |= marked
    last, whole = (np.flatnonzero(np.append(x[:-1], True)) for x in (cuts | ends, ends))
    if len(last) == costs.size > 1:
        raise ValueError("every episode has one row: sums over episodes cannot give EMCC")
    ids = (np.cumsum(cuts) - cuts)[last] if "rollout" in columns else None
    lengths, of_episodes = (np.diff(rows, prepend=-1) for rows in (last, whole))
    records = EpisodeRecords.from_costs(costs, lengths, rewards, ids, threshold)
    if len(whole) == len(last):
        return records, None
    return records, EpisodeRecords.from_costs(costs, of_episodes, rewards, None, threshold)


def _marked(columns: Columns, marks: list[str]) -> NDArray[np.bool_]:
    """Return the mask of the rows that any of the columns `marks` marks as an episode's last."""
    marked = np.zeros(len(columns.lines), dtype=bool)
    for name in marks:
        words = [text.lower().removesuffix(".0") for text in columns[name]]
        if bad := set(words) - {"0", "1", "false", "true"}:
            raise ValueError(f"column {name}: must be 0 or 1, got {min(bad)!r}")
        marked |= np.isin(words, ["1", "true"])
    return marked


def _runs(columns: Columns, ends: NDArray[np.bool_]) -> str:
    """Return the column that identifies runs, which are blocks of rows; "" if there is none. A
    column with one seed per episode does not count. ends: mask of the rows that end an episode."""
    for name, values in columns.items():
        if RUN.fullmatch(_letters(name)):
            blocks = 1 + sum(a != b for a, b in pairwise(values))
            if 1 < blocks == len({*values}) < ends.sum():
                return name
    return ""


def _environments(columns: Columns, ends: NDArray[np.bool_]) -> str:
    """Return the column that identifies several environments; "" if there is none.

    Its name matches `ENVIRONMENT`, or its values repeat in turns, like those of interleaved steps:
    0, 1, 2, 0, 1, 2, ... The number of a step in its episode also does so, but starts again after
    each end. ends: mask of the rows that end an episode or a rollout.
    """
    for name, values in columns.items():
        count = len({*values})
        if name in (*KNOWN, *ENDS) or count == 1 or STEP.fullmatch(_letters(name)):
            continue
        if ENVIRONMENT.fullmatch(_letters(name)):
            return name
        # At least three turns: fewer may be chance.
        if 3 * count <= len(values) and len({*values[:count]}) == count:
            again = all(a == b for a, b in zip(values, values[count:], strict=False))
            if again and not ends[count - 1 :: count].all():
                return name
    return ""


def _not_rising(columns: Columns, ends: NDArray[np.bool_]) -> str:
    """Return a column that counts steps but does not rise within an episode; "" if there is none.
    Columns with fractions are times, which may be rounded. ends: as in `_environments`."""
    for name, values in columns.items():
        if STEP.fullmatch(_letters(name)) and all(map(WHOLE.fullmatch, values)):
            rising = np.diff(columns.numbers(name, float)) > 0
            if len({*values}) > 1 and not (rising | ends[:-1]).all():
                return name
    return ""


def _letters(name: str) -> str:
    return re.sub(r"[^a-z]", "", name.lower())


def from_minari(dataset: Any, threshold: float = 0.0) -> EpisodeRecords:
    """Return the records of a Minari data set, each episode a rollout, in the data set's order.

    dataset: a minari.MinariDataset recorded with `record_infos=True`, with "cost" in the infos.
    Infos have one entry more than the episode has steps: the cost of the reset is dropped.
    threshold: a step whose cost exceeds it is a cost step.
    ValueError: no episode, or an episode whose costs are missing, of wrong length, negative or NaN.
    """
    costs, rewards = [], []
    for episode in dataset.iterate_episodes():
        name, steps = f"episode {episode.id}", len(episode.rewards)
        if "cost" not in (episode.infos or {}):
            raise ValueError(
                f"{name} has no 'cost' in its infos (it has {sorted(episode.infos or {})}): record "
                "with record_infos=True from an environment whose info has a cost"
            )
        cost = as_array(episode.infos["cost"], f"costs of {name}").reshape(-1)
        if len(cost) != steps + 1:
            needed = "a cost of the reset and of every step is needed"
            raise ValueError(f"{name} has {steps} steps and {len(cost)} costs; {needed}")
        costs.append(cost[1:])
        rewards.append(as_array(episode.rewards, f"rewards of {name}"))
    if not costs:
        raise ValueError("the data set has no episode")
    return EpisodeRecords.from_costs(costs, None, rewards, threshold=threshold)


def from_tensordict(batches: Any, rollout: str = "batch", threshold: float = 0.0) -> EpisodeRecords:
    """Return the records of a TorchRL TensorDict, or of the TensorDicts that a collector yields.

    batches: a TensorDict [time] or [..., time] with ("next", "cost"), ("next", "reward") and
    ("next", "done"), or an iterable of them. The environment has to provide the cost: call
    `env.auto_register_info_dict()` for a GymEnv. Every index of the other dimensions is an
    environment, stepped together with the others; time is the dimension named "time", else the
    last.
    rollout: "batch" if the policy is updated after each batch: the batch's end cuts the running
    episodes; "episode" if each episode is a rollout: running episodes continue in the next batch.
    Episodes that have not ended with the last batch are trajectories as well.
    threshold: a step whose cost exceeds it is a cost step.
    KeyError: no cost. ValueError: no batch, an unknown rollout, batches that differ in their number
    of environments, or trajectories that a collector has split and padded (`split_trajs=True`).
    """
    if rollout not in ("batch", "episode"):
        raise ValueError(f'rollout must be "batch" or "episode", got {rollout!r}')
    recorder = None
    for batch in [batches] if hasattr(batches, "batch_size") else batches:
        if batch.get(("collector", "mask"), None) is not None:
            raise ValueError("padded trajectories do not tell their order: use split_trajs=False")
        cost, reward, done = (_steps(batch, name) for name in ("cost", "reward", "done"))
        envs = cost.shape[1]
        if recorder is None:
            recorder = CostRecorder(envs, "manual" if rollout == "batch" else rollout, threshold)
        if envs != recorder.num_envs:
            raise ValueError(f"a batch has {envs} environments, the first {recorder.num_envs}")
        for step in range(len(cost)):
            recorder.step(cost[step], reward[step], done[step])
        if rollout == "batch":
            recorder.end_rollout()
    if recorder is None:
        raise ValueError("there is no batch")
    recorder.cut()  # the episodes that are still running
    return recorder.records


def _steps(batch: Any, name: str) -> NDArray[Any]:
    """Return ("next", name) as an array [time, environments]."""
    values = batch.get(("next", name), None)
    if values is None:
        raise KeyError(
            f"the batch has no ('next', {name!r}); for a cost, call env.auto_register_info_dict() "
            "before collecting"
        )
    shape = tuple(batch.batch_size)
    if not shape:
        raise ValueError("the batch must have a time dimension, got batch_size []")
    names = list(getattr(batch, "names", None) or [])
    time = names.index("time") if "time" in names else len(shape) - 1
    array = as_array(values, name).reshape(shape)  # drops the last axis, which has size 1
    return np.moveaxis(array, time, 0).reshape(shape[time], -1)
