"""Tables of trained runs beside the paper's."""

from __future__ import annotations

import dataclasses
import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from agents.algorithms import ALGORITHMS, algorithm
from agents.bench.pictures import ALPHA, draw_heatmaps
from agents.bench.presets import preset
from agents.errors import UserError
from agents.runs.config import FAILURE, TrainConfig, run_folder
from agents.runs.files import read_json, write_whole
from agents.runs.tasks import circle2d_config
from circle2d_mj.task import position as task_position
from emcc import EpisodeRecords, cost_rate, emcc_by_part, estimate
from emcc.table import Table

MEASURES = ("EMCC_0.33", "EMCC_0.66", "EMCC_0.99", "cost_rate", "J_R", "J_C", "CVaR_0.5")


@dataclass(frozen=True)
class Run:
    """What one run comes to: the measures by name, and where its episodes end."""

    seed: int
    measures: dict[str, float]
    episodes: int
    ends: str


def report(folder: Path, with_pictures: bool = False) -> str:
    """The table of every folder of runs at or below `folder`, as Markdown.

    Writes `report.md` and `report.csv` there, with_pictures also a heat map of each folder's
    training into `pictures`. Runs that are missing, damaged or unfinished are named below the
    table and left out of its means; pictures that cannot be drawn are named too. Raises UserError
    where no run is left.
    """
    notes: list[str] = []
    configs = _read_configs(folder, notes)
    if not configs and not notes:
        raise UserError(f"{folder} holds no runs: no config.json that circle2d train wrote")
    groups = [(config, _read_runs(path, config, notes)) for path, config in configs.items()]
    if not any(runs for _, runs in groups):
        raise UserError(f"{folder} holds no complete runs" + "".join(f"; {n}" for n in notes))
    tasks = dict.fromkeys(config.task for config, _ in groups)
    tables = [_table([g for g in groups if g[0].task == task]) for task in tasks]
    seeds = {
        path: tuple(run.seed for run in runs)
        for path, (_, runs) in zip(configs, groups, strict=True)
        if runs
    }
    drawn = draw_heatmaps(folder, seeds, notes) if with_pictures else []
    tables[-1] = dataclasses.replace(tables[-1], notes=[*tables[-1].notes, *notes])
    markdown = "\n".join(table.render("md") for table in tables)
    images = [f"![Visited states: {path.stem}]({path})" for path in drawn]
    write_whole(folder / "report.md", "\n".join([markdown, *images]))
    write_whole(folder / "report.csv", "\n".join(table.render("csv") for table in tables))
    return markdown


def _read_configs(folder: Path, notes: list[str]) -> dict[Path, TrainConfig]:
    """The configuration of every folder of runs, by path; damaged ones go into the notes."""
    if not folder.is_dir():
        raise UserError(f"{folder} is no folder")
    configs = {}
    for path in sorted(folder.rglob("config.json")):
        try:
            if "seed" not in read_json(path):  # that of a single run has one seed
                configs[path.parent] = TrainConfig.read(path.parent)
        except UserError as error:
            notes.append(f"left out: {error}")
    return configs


def _read_runs(folder: Path, config: TrainConfig, notes: list[str]) -> list[Run]:
    runs = []
    for seed in config.seeds:
        path = run_folder(folder, seed)
        try:
            runs.append(_read_run(path, config, seed))
        except (UserError, ValueError, OSError, KeyError, TypeError) as error:
            notes.append(f"left out: {path}: {error}")
    return runs


def _read_run(path: Path, config: TrainConfig, seed: int) -> Run:
    if (path / FAILURE).exists():
        step = read_json(path / FAILURE)["step"]
        raise UserError(f"failed at step {step}: it met a number that is not finite")
    if not (path / "episodes.csv").exists():
        raise UserError("has no checkpoint yet")
    records = EpisodeRecords.load(path / "episodes.csv")
    if records.total_steps < config.steps:
        raise UserError(f"is unfinished: {records.total_steps} of {config.steps} steps")
    content = read_json(path / "evaluation.json")
    evaluation = content["deterministic"]
    parts = emcc_by_part(*records.mcc_per_rollout(), config.steps, ALPHA)
    measures = {f"EMCC_{part}": value for part, value in parts.items()}
    measures["cost_rate"] = cost_rate(records.cost, records.length)
    measures |= {name: float(evaluation[name]) for name in MEASURES[4:]}
    if not np.isfinite(list(measures.values())).all():
        raise UserError(f"evaluation.json has numbers that are not finite: {measures}")
    return Run(seed, measures, content["episodes"], _ends(config, evaluation))


def _ends(config: TrainConfig, evaluation: dict[str, Any]) -> str:
    """Where most of the evaluated episodes ended, for a Circle2D task."""
    task = circle2d_config(config.task, config.task_parameters)
    if task is None:
        return ""
    position = task_position(task, np.array(evaluation["final_observations"]))
    (place, count), *others = Counter(task.region.places(position)).most_common()
    return f"{place} ({100 * count / len(position):.0f} %)" if others else place


def _table(groups: Sequence[tuple[TrainConfig, list[Run]]]) -> Table:
    """One task: for each algorithm the means above the paper's numbers, then every run."""
    config = groups[0][0]
    head = [config.task, *(name.replace("cost_rate", "cost rate") for name in MEASURES), "ends in"]
    names = {config.algorithm for config, _ in groups}
    rows, of_runs = [], []
    for name in (name for name in ALGORITHMS if name in names):
        for config, runs in (group for group in groups if group[0].algorithm == name):
            title = _title(config)
            if runs:
                rows.append([f"{title}, mean of {len(runs)}", *_means(runs), ""])
            for run in runs:
                cells = [f"{run.measures[measure]:.2f}" for measure in MEASURES]
                of_runs.append([f"{title}, seed {run.seed}", *cells, run.ends])
        title = algorithm(name).title
        paper = paper_results(config.task, title)
        if paper:
            rows.append([f"{title}, paper (3 seeds)", *(f"{v:.2f}" for v in paper.values()), ""])
    episodes = sorted({run.episodes for _, runs in groups for run in runs})
    caption = (
        f"EMCC with alpha = {ALPHA:g}, all values at the quantile kept; J_R, J_C and CVaR: "
        f"undiscounted, deterministic policy, {' or '.join(map(str, episodes)) or 'no'} episodes; "
        "[95 % bootstrap interval over seeds]"
    )
    return Table(caption, head, [*rows, *of_runs], _paper_notes(groups))


def _title(config: TrainConfig) -> str:
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


def _paper_notes(groups: Sequence[tuple[TrainConfig, list[Run]]]) -> list[str]:
    """What in our presets the paper does not print, where it matters."""
    configs = [config for config, _ in groups if config.task.startswith("Circle2D-")]
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
