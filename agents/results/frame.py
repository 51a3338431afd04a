"""Groups of runs by name, in order, and runs as frames."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from agents.algorithms import ALGORITHMS, title
from agents.errors import UserError
from agents.paper.presets import preset, usual_steps  # the settings that runs are named against
from agents.results.measures import measures
from agents.results.reading import Group, run_records
from agents.training.config import RunId, TrainConfig
from emcc.records import COLUMNS as RECORD_COLUMNS

if TYPE_CHECKING:
    import pandas

COLUMNS = ("group", "task", "algorithm", "settings", "cost", "folder", "seed", "ends_in")
COLUMNS = (*COLUMNS, "measure", "part", "value")


def frame(groups: Sequence[Group]) -> pandas.DataFrame:
    """A row for each complete run and measure.

    group: number of the runs that differ in their seeds alone, for group-bys. settings: those that
    are not the preset's, in words. cost: that the measures are of. ends_in: where most evaluated
    episodes end, empty for a task without named places. part: end of the third of training that the
    measure is of, NaN for one of the whole. value: NaN where the run lacks it.
    """
    import pandas as pd

    rows = [
        (
            *(number, group.task, group.config.algorithm, settings_of(group), group.cost),
            group.folder,
            *(run.seed, run.place, m.stem, m.part, run.measures.get(m.name)),
        )
        for number, group in enumerate(groups)
        for run in group.runs
        for m in measures()
    ]
    made = pd.DataFrame(rows, columns=list(COLUMNS))
    return made.astype({"part": float, "value": float})


def long_frame(
    trainings: Sequence[tuple[str, TrainConfig, Mapping[str, NDArray]]],
    rows: Literal["episodes", "updates"],
) -> pandas.DataFrame:
    """A row for each episode, or each epoch's update, of every run so far.

    trainings: name of the folder, configuration, and results of each. Settings in which they differ
    have a column each. Raises UserError for updates of an archive, which has none.
    """
    import pandas as pd

    frames, columns_of = [], _episodes if rows == "episodes" else _updates
    settings = [vars(c.hyperparameters) | c.task_parameters for _, c, _ in trainings]
    every = dict.fromkeys(name for own in settings for name in own)
    varied = [k for k in every if len({repr(own.get(k)) for own in settings}) > 1]
    for (folder, config, arrays), own in zip(trainings, settings, strict=True):
        about = {"folder": folder, "algorithm": config.algorithm} | {k: own.get(k) for k in varied}
        for run in config.runs:
            columns = columns_of(arrays, run, config)
            count = len(next(iter(columns.values())))
            first = {**about, "task": run.task, "seed": run.seed}
            # Lists, since a hyper-parameter may be a tuple.
            frames.append(pd.DataFrame({k: [v] * count for k, v in first.items()} | columns))
    return pd.concat(frames, ignore_index=True)


def _episodes(arrays: Mapping[str, NDArray], run: RunId, config: TrainConfig) -> dict[str, Any]:
    """Columns of the episodes of a run; further costs by their names."""
    first, *others = config.costs
    records = run_records(arrays, run, first)
    columns = {k: getattr(records, "reward" if k == "return" else k) for k in RECORD_COLUMNS}
    for other in others:
        of_other = run_records(arrays, run, other)
        columns |= {other: of_other.cost, f"{other}_longest_streak": of_other.longest_streak}
    return columns


def _updates(arrays: Mapping[str, NDArray], run: RunId, config: TrainConfig) -> dict[str, Any]:
    """Columns of the updates of a run; `step`: environment steps taken by then."""
    if f"{run.prefix}updates" not in arrays:
        if f"{run.prefix}failure" in arrays and f"{run.prefix}length" not in arrays:
            return {"rollout": np.arange(0), "step": np.arange(0)}  # it failed in its first epoch
        raise UserError(f"{run} has no updates: an archive keeps none")
    values = arrays[f"{run.prefix}updates"]
    rollouts = arrays[f"{run.prefix}rollouts"].astype(np.int64)
    lengths = arrays[f"{run.prefix}length"].astype(np.int64)
    steps = np.add.reduceat(lengths, np.cumsum(rollouts) - rollouts).cumsum()
    return {"rollout": np.arange(len(values)), "step": steps} | dict(
        zip(arrays["metrics"].tolist(), values.T, strict=True)
    )


def with_distinct_titles(groups: Sequence[Group]) -> list[Group]:
    """Groups of which those of one title on one task have their folders in their names."""
    keys = [(group.task, group.cost, title_of(group.config, group.task)) for group in groups]
    count = Counter(key for key, group in zip(keys, groups, strict=True) if group.runs)
    return [
        dataclasses.replace(
            group,
            apart=", ".join(filter(None, [group.apart, f"in {group.title}" * (count[key] > 1)])),
        )
        for key, group in zip(keys, groups, strict=True)
    ]


def name_of(group: Group) -> str:
    """The title of a group, with what tells it apart from another of that title."""
    return title_of(group.config, group.task, group.apart)


def title_of(config: TrainConfig, task: str, more: str = "") -> str:
    """The algorithm, with the settings that are not the usual ones."""
    words = ", ".join(filter(None, [*differences(config, task), more]))
    return title(config.algorithm) + (f" ({words})" if words else "")


def settings_of(group: Group) -> str:
    """The settings of a group that are not the usual ones, in words."""
    return ", ".join(filter(None, [*differences(group.config, group.task), group.apart]))


def differences(config: TrainConfig, task: str) -> list[str]:
    """Each setting of `changes` in words, and the number of steps where it is not the usual one. Of
    an unregistered algorithm, whose preset nobody knows, no hyper-parameter."""
    known = config.algorithm in ALGORITHMS
    changed = changes(config, task) if known else config.task_parameters
    return [f"{name} {value}" for name, value in changed.items()] + unusual_steps(config, task)


def unusual_steps(config: TrainConfig, task: str) -> list[str]:
    """The training's length, where it is not the usual one: see `presets.usual_steps`."""
    return [] if config.steps == usual_steps(task) else [f"{config.steps:,} steps"]


def changes(config: TrainConfig, task: str) -> dict[str, Any]:
    """Settings that differ from the preset and from the task as it is registered."""
    return hyperparameter_changes(config, task) | config.task_parameters


def hyperparameter_changes(config: TrainConfig, task: str) -> dict[str, Any]:
    """The hyper-parameters that differ from the preset; all of an unregistered algorithm."""
    chosen = dataclasses.asdict(config.hyperparameters)
    if config.algorithm not in ALGORITHMS:
        return chosen
    usual = dataclasses.asdict(preset(config.algorithm, task))
    return {name: value for name, value in chosen.items() if value != usual[name]}


def in_order(groups: Iterable[Group]) -> list[Group]:
    """Groups in the order of the algorithms."""
    order = {name: index for index, name in enumerate(ALGORITHMS)}
    return sorted(groups, key=lambda group: order.get(group.config.algorithm, len(order)))


def by_task(groups: Iterable[Group]) -> dict[str, list[Group]]:
    """Groups with complete runs by their task, in the order of the algorithms."""
    tasks: dict[str, list[Group]] = {}
    for group in in_order(groups):
        if group.runs:
            tasks.setdefault(group.task, []).append(group)
    return dict(sorted(tasks.items()))
