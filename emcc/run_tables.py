"""Tables of training runs: EMCC by thirds, panels, and the bounds that sums allow."""

import json
from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from emcc.inputs import RECORDED, EpisodeSums, EpochMeans, Run
from emcc.measures import cost_measures
from emcc.panels import WINDOW, panel, panel_table
from emcc.parts import cost_rate, rollouts_by_part
from emcc.statistics import COST, SHARE
from emcc.streaks import streak_bounds
from emcc.table import MISSING, Table, intervals, mean_cell
from emcc.tail import emcc


def emcc_table(
    runs: Sequence[Run], alpha: float, ties: str, seed: int = 0, per_run: bool = False
) -> Table:
    """One row per task, algorithm, settings and planned steps: means over its runs; with per_run,
    they follow.

    seed: of the bootstrap. Runs without a task and an algorithm have a row each.
    ValueError: alpha, ties or the steps of a run are not allowed.
    """
    measures = {run: _measures(run, alpha, ties) for run in runs}
    groups = _groups(runs)
    rows = []
    for key, members in groups.items():
        label = [key.task or MISSING, _name(key, list(groups))]
        rows.append([*label, str(len(members)), *_cells(members, measures, seed)])
        if per_run:
            for run in members:
                rows.append([*label, f"seed {run.seed or '?'}", *_cells([run], measures, seed)])
    caption = (
        f"EMCC with alpha = {alpha:g}, ties = {ties}: {_READINGS[ties]} in each third of training; "
        f"means over runs {intervals()}"
    )
    names = list(measures[runs[0]])
    return Table(
        caption,
        ["task", "algorithm", "runs", "steps", "steps from", *names],
        rows,
        [note for run in runs for note in _notes(run, _missing(measures[run]))]
        + _notes_of_groups(groups),
        complete=all(
            value is not None for of_run in measures.values() for value in of_run.values()
        ),
    )


class Key(NamedTuple):
    """The properties that runs of one row share."""

    task: str
    algorithm: str
    """Or the path, where there is none."""
    settings: str
    total_steps: int | None
    """As planned; None where only the recorded steps are known, which differ by chance."""


def _groups(runs: Sequence[Run]) -> dict[Key, list[Run]]:
    groups: dict[Key, list[Run]] = {}
    for run in runs:
        planned = None if run.total_from == RECORDED else run.total_steps
        key = Key(run.task, run.algorithm or str(run.path), run.settings, planned)
        groups.setdefault(key, []).append(run)
    return groups


def _name(key: Key, keys: Sequence[Key]) -> str:
    """The algorithm, with what differs where others have its name on the same task."""
    others = [_told(other) for other in keys if other[:2] == key[:2]]
    differing = [
        f"{name} {value}"
        for name, value in _told(key).items()
        if any(other.get(name) != value for other in others)
    ]
    return f"{key.algorithm} ({', '.join(differing)})" if differing else key.algorithm


def _told(key: Key) -> dict[str, Any]:
    """The settings and the length of runs, by name."""
    settings = _flat(json.loads(key.settings)) if key.settings else {}
    return settings if key.total_steps is None else settings | {"total steps": key.total_steps}


def _flat(settings: dict[str, Any]) -> dict[str, Any]:
    """The entries of a kind of settings, or what stands there instead, by name."""
    found: dict[str, Any] = {}
    for kind, values in settings.items():
        found |= values if isinstance(values, dict) else {kind: values}
    return found


_READINGS = {
    "all": "mean of all MCC values at or above the (1 - alpha) quantile",
    "split": "mean of exactly the share alpha of highest MCC values",
}


def _measures(run: Run, alpha: float, ties: str) -> dict[str, float | None]:
    """The numbers of one run; None where no rollout has started yet."""
    mcc, parts = run.rollouts[0], _parts(run)
    values: dict[str, float | None] = {
        f"EMCC_{part}": emcc(mcc[where], alpha, ties) if where.any() else None
        for part, where in parts.items()
    }
    rate = cost_rate(run.records.cost, run.records.length) if run.steps else None
    return values | {"cost rate": rate}


def _parts(run: Run) -> dict[float, NDArray[np.bool_]]:
    """Masks of the rollouts of each third."""
    try:
        return rollouts_by_part(run.rollouts[1], run.total_steps)
    except ValueError as error:
        raise ValueError(
            f"{run.path}: {error}; total steps are from {run.total_from}, --total-steps sets them"
        ) from None


def _cells(runs: list[Run], measures: dict[Run, dict[str, float | None]], seed: int) -> list[str]:
    steps = ", ".join(dict.fromkeys(str(run.total_steps) for run in runs))
    source = ", ".join(dict.fromkeys(run.total_from for run in runs))
    means = [
        mean_cell(
            [measures[run][name] for run in runs],
            3,
            seed,
            SHARE if name.startswith("EMCC") else COST,
        )
        for name in measures[runs[0]]
    ]
    return [steps, source, *means]


def _missing(measures: dict[str, float | None]) -> list[str]:
    return [name for name, value in measures.items() if value is None]


def _notes(run: Run, missing: list[str]) -> list[str]:
    notes = [run.note] if run.note else []
    if run.steps < run.total_steps:
        notes.append(f"{run.path} is unfinished: {run.steps} of {run.total_steps} steps.")
    if missing:
        notes.append(f"{run.path} has no rollout yet for {', '.join(missing)}.")
    return notes


def _notes_of_groups(groups: dict[Key, list[Run]]) -> list[str]:
    notes = []
    for key, runs in groups.items():
        name = f"{key.task} {key.algorithm}"
        for seed, times in Counter(run.seed for run in runs if run.seed).items():
            if times > 1:
                notes.append(
                    f"{name}: {times} runs have seed {seed}; their interval may be too narrow."
                )
        steps = [run.total_steps for run in runs]
        if min(steps) < max(steps):
            notes.append(
                f"{name}: means over runs of {min(steps)} to {max(steps)} recorded steps; steps in "
                "config.json keep runs of other planned lengths apart."
            )
    return notes


def panel_tables(
    runs: Sequence[Run],
    limit: float,
    alpha: float,
    ties: str,
    window: int = WINDOW,
    seed: int = 0,
    per_run: bool = False,
) -> list[Table]:
    """A panel for each row of `emcc_table`: means over its runs; with per_run, one for every run
    follows. The arguments are those of `emcc.panel` and `emcc_table`."""
    tables = []
    groups = _groups(runs)
    for key, members in groups.items():
        notes, panels = [], []
        # One window for all runs, since a row names it; a run without episodes is refused below.
        shared = min([window, *(len(run.records) for run in members if len(run.records))])
        for run in members:
            missing = [f"EMCC_{part}" for part, where in _parts(run).items() if not where.any()]
            notes += _notes(run, missing)
            try:
                of_run = panel(run.records, limit, alpha, ties=ties, window=shared,
                    total_steps=run.total_steps)  # fmt: skip
            except ValueError as error:
                raise ValueError(f"{run.path}: {error}") from None
            panels.append(of_run)
        name = " on ".join(filter(None, (_name(key, list(groups)), key.task)))
        notes += _notes_of_groups({key: members})
        tables.append(panel_table(panels, name, notes, seed))
        if per_run and len(members) > 1:
            for run, of_run in zip(members, panels, strict=True):
                tables.append(panel_table([of_run], f"{name}, seed {run.seed or '?'}"))
    return tables


def bounds_table(sums: Sequence[EpisodeSums], limit: float | None = None) -> Table:
    """Bounds of longest streak / length, and the measures of cost that sums of episodes give."""
    rows = []
    for entry in sums:
        low, high = streak_bounds(entry.cost, entry.length)
        of_costs = cost_measures(entry.cost, entry.length, limit, alpha=1, window=1, ties="all")
        numbers = [(bound / entry.length).mean() for bound in (low, high)]
        numbers += [of_costs.cost_rate, of_costs.maximum]
        if limit is not None:
            numbers += [of_costs.violation_rate, of_costs.severity]
            numbers += [of_costs.severity_of_violations, of_costs.regret]
        sizes = [str(entry.path), str(len(low)), str(entry.length.sum())]
        rows.append([*sizes, *(MISSING if x is None else f"{x:.3f}" for x in numbers)])
    with_limit = ["violation rate V", "severity D", "severity of violations D+", "cost regret"]
    head = ["file", "episodes", "steps", "at least", "at most", "cost rate", "highest cost"]
    return Table(
        "Bounds, not EMCC: longest streak / length, means over all episodes"
        f"{'' if limit is None else f'; limit {limit:g}'}. The sum of an episode's costs does not "
        "tell in which order they came.",
        head if limit is None else [*head, *with_limit],
        rows,
        [],
    )


def epochs_table(means: Sequence[EpochMeans], limit: float | None = None) -> Table:
    """The measures of cost that means of epochs give."""
    rows = []
    for entry in means:
        steps = np.diff(entry.total_steps, prepend=0)
        rate = (steps * entry.cost / entry.length).sum() / entry.total_steps[-1]
        numbers = [rate, entry.cost.max(), entry.cost[-1]]
        if limit is not None:
            numbers.append((entry.cost > limit).mean())
        sizes = [str(entry.path), str(len(steps)), str(entry.total_steps[-1])]
        rows.append([*sizes, *(f"{number:.3f}" for number in numbers)])
    head = ["file", "epochs", "steps", "cost rate", "highest mean cost", "last mean cost"]
    return Table(
        "Means of epochs, not EMCC: the cost rate, and the mean cost of an episode. They tell "
        "neither streaks nor the costs of single episodes, so neither EMCC and its bounds nor "
        "violation rate, severity, regret and CVaR. Where the library averages over past episodes, "
        "beyond the epoch, the numbers are smoothed.",
        head if limit is None else [*head, f"epochs with a mean above {limit:g}"],
        rows,
        [],
    )
