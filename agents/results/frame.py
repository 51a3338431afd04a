"""Results of runs as tidy data frames."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import product
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from agents.errors import UserError
from agents.results.groups import Group, Training
from agents.results.measures import measures
from agents.results.names import with_names
from agents.results.reading import read_groups, run_records
from agents.training import evaluation
from agents.training.config import POLICIES, RunId
from agents.training.files import Arrays, numbered
from emcc.records import COLUMNS as RECORD_COLUMNS

if TYPE_CHECKING:
    from pathlib import Path

    import pandas

COLUMNS = (
    *("source", "group", "name", "task", "algorithm", "settings", "cost", "limit", "folder"),
    *("seed", "steps", "ends_in", "measure", "part", "window", "value", "failure"),
)


def read(
    paths: Sequence[Path],
    window: int | None = None,
    printed: Callable[[Group], Group] | None = None,
) -> pandas.DataFrame:
    """Return the frame of all runs, complete or not, in folders (searched downwards) and archives.

    window, and the errors raised: see `reading.read_groups`. printed: adds to a group the numbers
    that a publication prints for it; these get rows too.
    """
    groups = read_groups(paths, [], None, window)
    return frame([*map(printed, groups)] if printed else groups)


def rows(groups: Sequence[Group]) -> Iterator[tuple[Any, ...]]:
    """Yield a row of `COLUMNS` for each run and measure: the values whose means every table shows.

    source: "runs", or the publication that prints the value. group: index of the group, for
    group-bys. name: the algorithm with its settings and length. settings: those that differ from
    the preset, in words. cost: the cost that the measure is computed from; limit: its limit, None
    if the algorithm does not limit it. steps: environment steps that the run took. ends_in: the
    place where most evaluated episodes end, empty for a task without named places. measure: its
    name without the part; "rate" is the cost rate of a third, "length" the length of evaluated
    episodes. part: end of the third of training, None for a measure of all of training. window:
    episodes per window for a measure of a third, None for rollouts. value: None where the run lacks
    it. failure: why an incomplete run has no values; empty for the others. groups: already named.
    """
    every = measures(shown=False)
    for number, group in enumerate(groups):
        about = (number, group.full_name, group.task, group.config.algorithm, group.settings)
        about = (*about, group.cost, group.limit, group.folder)
        for run in group.runs:
            own = ("runs", *about, run.seed, run.total_steps, run.place)
            for m in every:
                window = None if m.part is None else run.window
                yield (*own, m.stem, m.part, window, run.measures.get(m.name), "")
        for seed, why in group.missing.items():
            own = ("runs", *about, seed, None, "")
            yield from ((*own, m.stem, m.part, None, None, why) for m in every)
        own = (group.publication, *about, None, None, "")
        for m in (m for m in every if m.name in group.printed):
            yield (*own, m.stem, m.part, None, group.printed[m.name], "")


def frame(groups: Sequence[Group]) -> pandas.DataFrame:
    """Return `rows` as a data frame; unknown values are NaN."""
    import pandas as pd

    made = pd.DataFrame(rows(with_names(groups)), columns=list(COLUMNS))
    made = made.astype(dict.fromkeys(("limit", "part", "window", "value"), float))
    return made.astype({"seed": "Int64", "steps": "Int64"})


def long_frame(
    trainings: Sequence[Training], rows: Literal["episodes", "updates", "evaluations"]
) -> pandas.DataFrame:
    """Return a row for each episode, epoch's update, or evaluated episode of every run so far.

    Each setting in which the trainings differ has a column. Raises UserError for the updates of an
    archive if the algorithm has no multiplier.
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
    # Empty frames would turn columns of integers into floats.
    return pd.concat([own for own in frames if len(own)] or frames, ignore_index=True)


def _episodes(training: Training, run: RunId) -> dict[str, Any]:
    """Return the columns of a run's episodes; each cost's column has the cost's name."""
    first, *others = training.config.costs
    records = run_records(training.arrays, run, first)
    columns = {k: getattr(records, "reward" if k == "return" else k) for k in RECORD_COLUMNS}
    columns = {first if k == "cost" else k: column for k, column in columns.items()}
    for other in others:
        of_other = run_records(training.arrays, run, other)
        columns |= {other: of_other.cost, f"{other}_longest_streak": of_other.longest_streak}
    return columns


def _updates(training: Training, run: RunId) -> dict[str, Any]:
    """Return the columns of a run's updates; `step`: environment steps taken before the update."""
    arrays = training.arrays
    if f"{run.prefix}length" not in arrays:  # no checkpoint yet, or it failed in its first epoch
        return {"rollout": np.arange(0), "step": np.arange(0)}
    if f"{run.prefix}updates" not in arrays:
        raise UserError(
            f"{run} has no updates: none was made, or it is in an archive, which keeps only "
            "multipliers"
        )
    values = arrays[f"{run.prefix}updates"]
    rollouts = arrays[f"{run.prefix}rollouts"].astype(np.int64)
    lengths = arrays[f"{run.prefix}length"].astype(np.int64)
    steps = np.add.reduceat(lengths, np.cumsum(rollouts) - rollouts).cumsum()
    epochs = arrays.get(f"{run.prefix}epochs", np.arange(len(values)))  # an archive keeps a few
    return {"rollout": epochs, "step": steps[epochs]} | dict(
        zip(arrays["metrics"].tolist(), values.T, strict=True)
    )


def _evaluations(training: Training, run: RunId) -> dict[str, Any]:
    """Return the columns of a run's evaluated episodes; each cost's column has the cost's name.

    step: of a policy kept during training the multiple of `evaluate_every` that its epoch reached,
    at the end the environment steps taken. The last policy's episodes are those of the end."""
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
