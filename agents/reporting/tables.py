"""The table of a task: our runs beside the paper's numbers."""

from __future__ import annotations

import dataclasses
import functools
import json
from collections.abc import Iterator, Mapping, Sequence
from importlib.resources import files
from typing import Any

import numpy as np

from agents.algorithms import ALGORITHMS, algorithm
from agents.paper.presets import PAPER_SEEDS, preset, unprinted, usual_steps
from agents.reporting.pictures import ALPHA
from agents.results.reading import MEASURES, Group, Run
from agents.training.config import TrainConfig
from circle2d_mj.registration import CIRCLE2D
from emcc import Difference, Estimate, difference, estimate
from emcc.table import Table

MARKING = (
    "the lowest EMCC and cost rate; J_R, J_C and CVaR of the highest return within the cost limit; "
    "among our means"
)


def task_table(groups: Sequence[Group]) -> Table:
    """One task: for each algorithm the means above the paper's numbers, then every run.

    What is best among the means, and among the paper's numbers, is marked: see `best`.
    """
    task = groups[0].config.task
    names = {group.config.algorithm for group in groups}
    rows, ours, papers = [], {}, {}
    for name in (name for name in ALGORITHMS if name in names):
        for group in (group for group in groups if group.config.algorithm == name and group.runs):
            ours[len(rows)] = means(group.runs), group.config.hyperparameters.cost_limit
            rows.append(mean_row(group))
        paper = paper_results(task, algorithm(name).title)
        if paper:
            papers[len(rows)] = paper, preset(name, task).cost_limit
            rows.append(paper_row(algorithm(name).title, paper))
    marked = {(row, 1 + MEASURES.index(m)) for row, m in best(ours) | best(papers)}
    rows += [row for name in ALGORITHMS for row in run_rows(groups, name)]
    table = measures_table(caption(groups), task, rows, _paper_notes(groups))
    marking = MARKING + (", and among the paper's" if papers else "")
    return dataclasses.replace(table, marked=frozenset(marked), marking=marking)


def measures_table(
    caption: str, first: str, rows: list[list[str]], notes: Sequence[str] = ()
) -> Table:
    """A table of rows whose cells are a name (headed by `first`), each measure, and where runs end;
    without the last column where no run's task has places."""
    head = [first, *(name.replace("cost_rate", "cost rate") for name in MEASURES), "ends in"]
    width = len(head) if any(row[-1] for row in rows) else -1
    return Table(caption, head[:width], [row[:width] for row in rows], list(notes))


def best(candidates: Mapping[int, tuple[Mapping[str, float], float]]) -> set[tuple[int, str]]:
    """Which measures of which candidates are best, as the paper's tables highlight them.

    candidates: measures and cost limit. The lowest of each EMCC part and of the cost rate; J_R, J_C
    and CVaR of the candidates of the highest J_R among those whose J_C is within their limit. All
    to the two digits that are printed, so that equal ones are marked together; nothing where there
    is nothing to compare with. Source: caption of table Circle2DResults.
    """
    if len(candidates) < 2:
        return set()
    printed = {
        key: {name: round(value, 2) for name, value in values.items()}
        for key, (values, _) in candidates.items()
    }
    marked = set()
    for name in MEASURES[:4]:
        lowest = min(values[name] for values in printed.values())
        marked |= {(key, name) for key, values in printed.items() if values[name] == lowest}
    within = [key for key, (_, limit) in candidates.items() if printed[key]["J_C"] <= limit]
    highest = max((printed[key]["J_R"] for key in within), default=None)
    of_highest = [key for key in within if printed[key]["J_R"] == highest]
    return marked | {(key, name) for key in of_highest for name in MEASURES[4:]}


def caption(groups: Sequence[Group]) -> str:
    """What the numbers of a table are."""
    episodes = sorted({run.episodes for group in groups for run in group.runs})
    return (
        f"EMCC with alpha = {ALPHA:g}, all values at the quantile kept; J_R, J_C and CVaR: "
        f"undiscounted, deterministic policy, {' or '.join(map(str, episodes)) or 'no'} episodes; "
        "[95 % bootstrap interval over seeds; of two or three it is their range]"
    )


def means(runs: Sequence[Run]) -> dict[str, float]:
    """The mean over some runs of each measure."""
    return {name: float(np.mean([run.measures[name] for run in runs])) for name in MEASURES}


def mean_row(group: Group, prefix: str = "") -> list[str]:
    """The row of the means of a group, with their intervals over seeds."""
    cells = [mean_cell([run.measures[name] for run in group.runs]) for name in MEASURES]
    return [f"{prefix}{title_of(group.config)}, mean of {len(group.runs)}", *cells, ""]


def paper_row(name: str, printed: Mapping[str, float]) -> list[str]:
    """The row of what the paper prints."""
    cells = [f"{printed[measure]:.2f}" for measure in MEASURES]
    return [f"{name}, paper ({PAPER_SEEDS} seeds)", *cells, ""]


def run_rows(groups: Sequence[Group], name: str, prefix: str = "") -> Iterator[list[str]]:
    """A row for each run of an algorithm."""
    for _, config, runs in (group for group in groups if group.config.algorithm == name):
        for run in runs:
            cells = [f"{run.measures[measure]:.2f}" for measure in MEASURES]
            yield [f"{prefix}{title_of(config)}, seed {run.seed}", *cells, run.ends]


def mean_cell(values: Sequence[float]) -> str:
    """A mean over seeds as text, with its interval where there are several."""
    return _estimate_cell(mean_of(values), "")


def mean_of(values: Sequence[float]) -> Estimate:
    """A mean over seeds with its 95 % bootstrap interval where there are several."""
    # A generator of its own: no number depends on which others are asked for.
    return estimate({"": values}, rng=np.random.default_rng(0))[""]


def difference_cell(difference: Difference) -> str:
    """A difference of means as text, with its interval where there are several seeds."""
    return _estimate_cell(difference, "+")


def difference_of(a: Sequence[Run], b: Sequence[Run], measure: str) -> Difference:
    """The mean of a measure over `b` less that over `a`, with its interval like `mean_of`."""
    values = [[run.measures[measure] for run in runs] for runs in (a, b)]
    return difference(*values, rng=np.random.default_rng(0))


def _estimate_cell(found: Estimate | Difference, sign: str) -> str:
    interval = "" if found.low is None else f" [{found.low:{sign}.2f}, {found.high:{sign}.2f}]"
    return f"{found.value:{sign}.2f}{interval}"


def title_of(config: TrainConfig) -> str:
    """The algorithm, with what differs from the preset, from the task as it is registered, and from
    the usual number of steps."""
    told = [f"{k} {v}" for k, v in changes(config).items()] + unusual_steps(config)
    return algorithm(config.algorithm).title + (f" ({', '.join(told)})" if told else "")


def unusual_steps(config: TrainConfig) -> list[str]:
    """How long was trained, where that is not as long as usual: see `presets.usual_steps`."""
    return [] if config.steps == usual_steps(config.task) else [f"{config.steps:,} steps"]


def changes(config: TrainConfig) -> dict[str, Any]:
    """What differs from the preset and from the task as it is registered."""
    return hyperparameter_changes(config) | config.task_parameters


def hyperparameter_changes(config: TrainConfig) -> dict[str, Any]:
    """The hyper-parameters that differ from the preset."""
    usual = dataclasses.asdict(preset(config.algorithm, config.task))
    chosen = dataclasses.asdict(config.hyperparameters)
    return {k: v for k, v in chosen.items() if v != usual[k]}


def paper_results(task: str, title: str) -> dict[str, float]:
    """The paper's printed numbers for an algorithm on a task; empty where it prints none."""
    printed = _paper()["results"]
    task = task.rpartition(":")[2]  # "module:id" names the task that "id" does
    task = task.removesuffix("-v0") if task.startswith("Circle2D-") else task.split("/")[-1]
    return {
        name: _as_meant(task, title, name, printed[task][name][title])
        for name in MEASURES
        if task in printed and title in printed[task][name]
    }


@functools.cache
def _paper() -> dict[str, Any]:
    return json.loads(files("agents.paper").joinpath("printed.json").read_text())


def _as_meant(task: str, title: str, measure: str, value: float) -> float:
    """The paper prints 4.68 here; no return of this task can be positive."""
    is_misprint = (task, title, measure) == ("Circle2D-1", "TRPO-Lag", "J_R")
    return -value if is_misprint else value


def _paper_notes(groups: Sequence[Group]) -> list[str]:
    """What in our presets the paper does not print, where it matters; what it did otherwise."""
    titles: dict[str, dict[str, None]] = {}
    for config in (group.config for group in groups):
        setting, title = unprinted(config.algorithm), algorithm(config.algorithm).title
        if (
            setting
            and setting.field not in hyperparameter_changes(config)
            and paper_results(config.task, title)
        ):
            choice = getattr(config.hyperparameters, setting.field)
            titles.setdefault(setting.choices[choice], {})[title] = None
    told = "Whether the paper did so is not printed."
    if groups[0].config.task.rpartition(":")[2] in CIRCLE2D:
        told = "That the paper did so is inferred from its results, not printed."
    notes = [f"{', '.join(of)}: {meaning}. {told}" for meaning, of in titles.items()]
    if any("circle2d_mj/Safety" in group.config.task for group in groups):
        notes.append("The paper evaluated 10 episodes of each run on the Safety tasks.")
    return notes
