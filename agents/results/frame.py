"""Runs as tidy frames, and the names of groups of runs."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import product
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from agents.algorithms import ALGORITHMS, title
from agents.errors import UserError
from agents.presets import preset, usual_steps
from agents.results.measures import measures
from agents.results.reading import Group, Training, read_groups, run_records
from agents.training import evaluation
from agents.training.config import POLICIES, RunId, TrainConfig
from agents.training.files import Arrays, numbered
from emcc.records import COLUMNS as RECORD_COLUMNS

if TYPE_CHECKING:
    from pathlib import Path

    import pandas

COLUMNS = (
    *("source", "group", "name", "task", "algorithm", "settings", "cost", "limit", "folder"),
    *("seed", "steps", "ends_in", "measure", "part", "window", "value", "failure"),
)
MOST_CHARACTERS = 40
"""Characters of a setting's value, at most, in a name."""


def read(
    paths: Sequence[Path],
    window: int | None = None,
    printed: Callable[[Group], Group] | None = None,
) -> pandas.DataFrame:
    """The frame of all runs at or below some folders and in archives, complete or not.

    window, and what is raised: see `reading.read_groups`. printed: gives a group the numbers that a
    publication prints for it, which have rows too.
    """
    groups = read_groups(paths, [], None, window)
    return frame([*map(printed, groups)] if printed else groups)


def frame(groups: Sequence[Group]) -> pandas.DataFrame:
    """A row for each run and measure.

    source: "runs", or the publication whose numbers these are. group: number of the group, for
    group-bys. name: of the algorithm with its settings, as tables have it. settings: those that are
    not the preset's, in words. cost: that the measures are of; limit: of it, NaN for an algorithm
    that does not limit it. steps: that the run took. ends_in: where most evaluated episodes end,
    empty for a task without named places. measure: its name, without the part: "rate" is the cost
    rate of a third, "length" that of evaluated episodes. part: end of the third of training that
    the measure is of, NaN for one of the whole. window: episodes of the windows over which a
    measure of a third is taken, NaN for rollouts. value: NaN where the run lacks it. failure: why a
    run is not complete, which has no values; empty for the others.
    """
    import pandas as pd

    every = measures(shown=False)
    rows: list[tuple[Any, ...]] = []
    varied = with_varied_settings(groups)
    named = zip(varied, map(name_of, with_distinct_titles(varied)), strict=True)
    for number, (group, name) in enumerate(named):
        about = (number, name, group.task, group.config.algorithm, settings_of(group))
        about = (*about, group.cost, group.limit, group.folder)
        for run in group.runs:
            own = ("runs", *about, run.seed, run.total_steps, run.place)
            for m in every:
                window = None if m.part is None else run.window
                rows.append((*own, m.stem, m.part, window, run.measures.get(m.name), ""))
        for seed, why in group.missing.items():
            own = ("runs", *about, seed, None, "")
            rows += [(*own, m.stem, m.part, None, None, why) for m in every]
        own = (group.publication, *about, None, None, "")
        values = [(m, group.printed[m.name]) for m in every if m.name in group.printed]
        rows += [(*own, m.stem, m.part, None, value, "") for m, value in values]
    numbers = ("limit", "part", "window", "value")
    made = pd.DataFrame(rows, columns=list(COLUMNS)).astype(dict.fromkeys(numbers, float))
    return made.astype({"seed": "Int64", "steps": "Int64"})


def long_frame(
    trainings: Sequence[Training], rows: Literal["episodes", "updates", "evaluations"]
) -> pandas.DataFrame:
    """A row for each episode, each epoch's update, or each evaluated episode of every run so far.

    Settings in which the trainings differ have a column each. Raises UserError for updates of an
    archive, which has none.
    """
    import pandas as pd

    columns_of = {"episodes": _episodes, "updates": _updates, "evaluations": _evaluations}[rows]
    configs = [training.config for training in trainings]
    frames, settings = [], [vars(c.hyperparameters) | c.task_parameters for c in configs]
    every = dict.fromkeys(name for own in settings for name in own)
    varied = [k for k in every if len({repr(own.get(k)) for own in settings}) > 1]
    for training, own in zip(trainings, settings, strict=True):
        about = {"folder": training.folder, "algorithm": training.config.algorithm}
        about |= {name: own.get(name) for name in varied}
        for run in training.config.runs:
            columns = columns_of(training, run)
            count = len(next(iter(columns.values())))
            first = {**about, "task": run.task, "seed": run.seed}
            # Lists, since a hyper-parameter may be a tuple.
            frames.append(pd.DataFrame({k: [v] * count for k, v in first.items()} | columns))
    return pd.concat(frames, ignore_index=True)


def _episodes(training: Training, run: RunId) -> dict[str, Any]:
    """Columns of the episodes of a run; costs by their names."""
    first, *others = training.config.costs
    records = run_records(training.arrays, run, first)
    columns = {k: getattr(records, "reward" if k == "return" else k) for k in RECORD_COLUMNS}
    columns = {first if k == "cost" else k: column for k, column in columns.items()}
    for other in others:
        of_other = run_records(training.arrays, run, other)
        columns |= {other: of_other.cost, f"{other}_longest_streak": of_other.longest_streak}
    return columns


def _updates(training: Training, run: RunId) -> dict[str, Any]:
    """Columns of the updates of a run; `step`: environment steps taken by then."""
    arrays = training.arrays
    if f"{run.prefix}updates" not in arrays:
        if f"{run.prefix}failure" in arrays and f"{run.prefix}length" not in arrays:
            return {"rollout": np.arange(0), "step": np.arange(0)}  # it failed in its first epoch
        raise UserError(
            f"{run} has no updates: none was made, or an archive, which keeps multipliers alone"
        )
    values = arrays[f"{run.prefix}updates"]
    rollouts = arrays[f"{run.prefix}rollouts"].astype(np.int64)
    lengths = arrays[f"{run.prefix}length"].astype(np.int64)
    steps = np.add.reduceat(lengths, np.cumsum(rollouts) - rollouts).cumsum()
    epochs = arrays.get(f"{run.prefix}epochs", np.arange(len(values)))  # of an archive a few
    return {"rollout": epochs, "step": steps[epochs]} | dict(
        zip(arrays["metrics"].tolist(), values.T, strict=True)
    )


def _evaluations(training: Training, run: RunId) -> dict[str, Any]:
    """Columns of the evaluated episodes of a run; `step`: environment steps taken by then; costs by
    their names."""
    kept = numbered(training.path / POLICIES, run.prefix).items()
    sources: dict[int, tuple[Mapping[str, NDArray], str]]
    sources = {step: (Arrays(path), "") for step, path in kept}
    if f"{run.prefix}evaluation/{evaluation.POLICIES[0]}/returns" in training.arrays:
        sources[int(training.arrays[f"{run.prefix}length"].sum())] = training.arrays, run.prefix
    names = ("step", "policy", "episode", "return", *training.config.costs, "length")
    columns: dict[str, list[Any]] = {name: [] for name in names}
    for (step, (arrays, prefix)), policy in product(sources.items(), evaluation.POLICIES):
        own = f"{prefix}evaluation/{policy}"
        if f"{own}/returns" in arrays:
            returns, costs, length = (arrays[f"{own}/{n}"] for n in ("returns", "costs", "lengths"))
            count = len(returns)
            values = ([step] * count, [policy] * count, range(count), returns, *costs.T, length)
            for name, column in zip(names, values, strict=True):
                columns[name] += list(column)
    return columns


def with_names(groups: Sequence[Group]) -> list[Group]:
    """Groups that their names tell apart."""
    return with_distinct_titles(with_varied_settings(groups))


def with_varied_settings(groups: Sequence[Group]) -> list[Group]:
    """Name groups of unregistered algorithms by the hyper-parameters in which they differ: there is
    no preset to compare with."""
    named = []
    for group in groups:
        name, varied = group.config.algorithm, []
        if name not in ALGORITHMS:
            others = [vars(g.config.hyperparameters) for g in groups if g.config.algorithm == name]
            own = vars(group.config.hyperparameters)
            varied = [setting(k, v) for k, v in own.items() if any(o.get(k) != v for o in others)]
        apart = ", ".join(filter(None, [*varied, group.apart]))
        named.append(dataclasses.replace(group, apart=apart))
    return named


def with_distinct_titles(groups: Sequence[Group]) -> list[Group]:
    """Name groups of one title on one task by their folders too."""
    keys = [(group.task, group.cost, title_of_group(group)) for group in groups]
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
    return title_of_group(group, group.apart)


def title_of_group(group: Group, more: str = "") -> str:
    """The title of a group's settings and length."""
    return title_of(group.config, group.task, more, group.total_steps)


def title_of(config: TrainConfig, task: str, more: str = "", steps: int | None = None) -> str:
    """The algorithm, with the settings that are not the usual ones; steps: taken, by default those
    asked for."""
    words = ", ".join(filter(None, [*unusual_settings(config, task, steps), more]))
    return title(config.algorithm) + (f" ({words})" if words else "")


def settings_of(group: Group) -> str:
    """The settings of a group that are not the usual ones, in words."""
    words = unusual_settings(group.config, group.task, group.total_steps)
    return ", ".join(filter(None, [*words, group.apart]))


def unusual_settings(config: TrainConfig, task: str, steps: int | None = None) -> list[str]:
    """Each setting of `changes` in words, and the number of steps where it is not the usual one; of
    an unregistered algorithm no hyper-parameter: see `with_varied_settings`."""
    known = config.algorithm in ALGORITHMS
    changed = changes(config, task) if known else config.task_parameters
    words = [setting(name, value) for name, value in changed.items()]
    return words + unusual_steps(steps or config.steps, task)


def setting(name: str, value: Any) -> str:
    """A setting in the words of names; of one whose value would fill a table's rows its number of
    values, or of characters, and a note below the table has the value."""
    if len(str(value)) <= MOST_CHARACTERS or not isinstance(value, (tuple, list, dict, str)):
        return f"{name} {value}"
    return f"{name} [{len(value)}{' characters' * isinstance(value, str)}]"


def unusual_steps(steps: int, task: str) -> list[str]:
    """A training's length, where it is not the usual one: see `presets.usual_steps`."""
    return [] if steps == usual_steps(task) else [f"{steps:,} steps"]


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
