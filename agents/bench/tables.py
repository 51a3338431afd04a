"""The table of a task: our runs beside the paper's numbers."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from importlib.resources import files
from typing import Any

import numpy as np

from agents.algorithms import ALGORITHMS, algorithm
from agents.bench.pictures import ALPHA
from agents.bench.presets import preset
from agents.bench.results import MEASURES, Group, Run
from agents.runs.config import TrainConfig
from emcc import estimate
from emcc.table import Table


def task_table(groups: Sequence[Group]) -> Table:
    """One task: for each algorithm the means above the paper's numbers, then every run."""
    config = groups[0].config
    head = [config.task, *(name.replace("cost_rate", "cost rate") for name in MEASURES), "ends in"]
    names = {group.config.algorithm for group in groups}
    rows, of_runs = [], []
    for name in (name for name in ALGORITHMS if name in names):
        for _, config, runs in (group for group in groups if group.config.algorithm == name):
            title = title_of(config)
            if runs:
                rows.append([f"{title}, mean of {len(runs)}", *_means(runs), ""])
            for run in runs:
                cells = [f"{run.measures[measure]:.2f}" for measure in MEASURES]
                of_runs.append([f"{title}, seed {run.seed}", *cells, run.ends])
        title = algorithm(name).title
        paper = paper_results(config.task, title)
        if paper:
            rows.append([f"{title}, paper (3 seeds)", *(f"{v:.2f}" for v in paper.values()), ""])
    episodes = sorted({run.episodes for group in groups for run in group.runs})
    caption = (
        f"EMCC with alpha = {ALPHA:g}, all values at the quantile kept; J_R, J_C and CVaR: "
        f"undiscounted, deterministic policy, {' or '.join(map(str, episodes)) or 'no'} episodes; "
        "[95 % bootstrap interval over seeds]"
    )
    return Table(caption, head, [*rows, *of_runs], _paper_notes(groups))


def title_of(config: TrainConfig) -> str:
    """The algorithm, with what differs from the preset and from the task as it is registered."""
    inside = ", ".join(f"{k} {v}" for k, v in _changes(config).items())
    return algorithm(config.algorithm).title + (f" ({inside})" if inside else "")


def _changes(config: TrainConfig) -> dict[str, Any]:
    """What differs from the preset and from the task as it is registered."""
    usual = dataclasses.asdict(preset(config.algorithm, config.task))
    chosen = dataclasses.asdict(config.hyperparameters)
    return {k: v for k, v in chosen.items() if v != usual[k]} | config.task_parameters


def _means(runs: list[Run]) -> list[str]:
    cells = []
    for name in MEASURES:
        values = [run.measures[name] for run in runs]
        mean = estimate({name: values}, rng=np.random.default_rng(0))[name]
        interval = "" if mean.low is None else f" [{mean.low:.2f}, {mean.high:.2f}]"
        cells.append(f"{mean.value:.2f}{interval}")
    return cells


def paper_results(task: str, title: str) -> dict[str, float]:
    """The paper's printed numbers for an algorithm on a task; empty where it prints none."""
    printed = json.loads(files("agents.bench").joinpath("paper.json").read_text())["results"]
    task = task.rpartition(":")[2]  # "module:id" names the task that "id" does
    task = task.removesuffix("-v0") if task.startswith("Circle2D-") else task.split("/")[-1]
    return {
        name: _as_meant(task, title, name, printed[task][name][title])
        for name in MEASURES
        if task in printed and title in printed[task][name]
    }


def _as_meant(task: str, title: str, measure: str, value: float) -> float:
    """The paper prints 4.68 here; no return of this task can be positive."""
    is_misprint = (task, title, measure) == ("Circle2D-1", "TRPO-Lag", "J_R")
    return -value if is_misprint else value


def _paper_notes(groups: Sequence[Group]) -> list[str]:
    """What in our presets the paper does not print, where it matters."""
    configs = [g.config for g in groups if "Circle2D-" in g.config.task]
    choices = {
        "the last step of an episode counts as terminal": [
            config
            for config in configs
            if "time_limit" not in _changes(config)
            and config.hyperparameters.time_limit == "terminal"
        ],
        "the multiplier ascends by Adam": [
            config
            for config in configs
            if "multiplier_optimizer" not in _changes(config) and config.algorithm == "trpo-lag"
        ],
    }
    titles = {
        choice: dict.fromkeys(algorithm(config.algorithm).title for config in chosen)
        for choice, chosen in choices.items()
    }
    inferred = "That the paper did so is inferred from its results, not printed."
    return [f"{', '.join(of)}: {choice}. {inferred}" for choice, of in titles.items() if of]
