"""The runs below a folder: what each comes to, and which are complete."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from agents.errors import UserError
from agents.reporting.pictures import ALPHA
from agents.training.config import FAILURE, TrainConfig, run_folder
from agents.training.environments import circle2d_config
from agents.training.files import read_json
from circle2d_mj.circle2d.task import position as task_position
from emcc import EpisodeRecords, cost_rate, emcc_by_part

MEASURES = ("EMCC_0.33", "EMCC_0.66", "EMCC_0.99", "cost_rate", "J_R", "J_C", "CVaR_0.5")


@dataclass(frozen=True)
class Run:
    """What one run comes to: the measures by name, where its episodes end, and its records."""

    seed: int
    measures: dict[str, float]
    episodes: int
    ends: str
    records: EpisodeRecords = field(repr=False)


class Group(NamedTuple):
    """The runs of one folder that are complete."""

    folder: Path
    config: TrainConfig
    runs: list[Run]


def read_groups(folder: Path, notes: list[str]) -> list[Group]:
    """The runs of every folder at or below `folder`.

    Those that are missing, damaged or unfinished go into the notes. Raises UserError where no run
    is left.
    """
    configs = _read_configs(folder, notes)
    if not configs and not notes:
        raise UserError(f"{folder} holds no runs: no config.json that circle2d train wrote")
    groups = [Group(path, c, _read_runs(path, c, notes)) for path, c in configs.items()]
    if not any(group.runs for group in groups):
        raise UserError(f"{folder} holds no complete runs" + "".join(f"; {n}" for n in notes))
    return groups


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
    return Run(seed, measures, content["episodes"], _ends(config, evaluation), records)


def _ends(config: TrainConfig, evaluation: dict[str, Any]) -> str:
    """Where the evaluated episodes ended most often, for a Circle2D task."""
    task = circle2d_config(config.task, config.task_parameters)
    if task is None:
        return ""
    position = task_position(task, np.array(evaluation["final_observations"]))
    (place, count), *others = Counter(task.region.places(position)).most_common()
    return f"{place} ({100 * count / len(position):.0f} %)" if others else place
