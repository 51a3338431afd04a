"""Typed results of the runs of a source, and which of them are complete."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from agents.errors import UserError
from agents.results.measures import RunData, measured
from agents.results.source import DamagedSource, Source
from agents.results.steps import Episode, Replay, Visits
from agents.training.config import NO_RUNS, TrainConfig
from agents.training.evaluation import CVAR_ALPHA, POLICIES
from emcc import EpisodeRecords, cvar

CVAR = f"CVaR_{CVAR_ALPHA:g}"


UNREADABLE = (OSError, ValueError, ArithmeticError, LookupError, TypeError, AttributeError)
"""Errors of values in a run's files that are of another kind than they should be."""


@dataclass(frozen=True)
class Run:
    """Results of one run."""

    seed: int
    measures: Mapping[str, float | None]
    """By the name of the measure; None for what the run lacks."""
    episodes: int
    """Evaluated ones of each policy."""
    ends: Mapping[str, int]
    """Evaluated episodes of the deterministic policy by the place where they end; empty for a task
    without named places."""
    records: EpisodeRecords = field(repr=False)
    evaluation: Mapping[str, Any] = field(default_factory=dict, repr=False)
    """Of `evaluation.json`: means of either policy, and arrays of values per episode, but for the
    final observations."""
    ways: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    """Of the episodes that end in a place, those that came by each way; empty where none tells."""

    @property
    def end(self) -> str:
        """The place where most of its evaluated episodes end; empty without places."""
        return max(self.ends, key=self.ends.__getitem__, default="")

    @property
    def way(self) -> str:
        """The way by which most of them came to that place; empty where it is unknown."""
        of = self.ways.get(self.end, {})
        return max(of, key=of.__getitem__, default="")

    @property
    def place(self) -> str:
        """Place and way; empty without places."""
        return ", ".join(filter(None, (self.end, self.way)))


def one_place(runs: Sequence[Run]) -> bool:
    """Whether all runs end in the same place by the same way, or the task has no places."""
    return len({run.place for run in runs}) < 2


@dataclass(frozen=True)
class Group:
    """The runs of one folder, or of several pooled ones, which differ in their seed only."""

    folder: str
    """Below the source's own: "." or like "Circle2D-1-v0/cpo"; of several with " + " between."""
    config: TrainConfig
    runs: Sequence[Run]
    """Those that are complete."""
    missing: Mapping[int, str] = field(default_factory=dict)
    """Why the others are left out, by seed."""
    apart: str = ""
    """Words that tell it from a group of equal settings in another folder, if there is one."""
    title: str = ""
    """The folder as seen from beside the report's."""
    recorded: Mapping[str, Any] = field(default_factory=dict, repr=False)
    """`config.json`: versions, machine, modules, commit."""
    pooled: Sequence[Group] = field(default=(), repr=False)
    """The groups of the single folders, where it has several."""
    source: Any = field(default=None, repr=False)

    @property
    def parts(self) -> Sequence[Group]:
        """The groups of the single folders; itself where it is of one."""
        return self.pooled or [self]

    @property
    def task(self) -> str:
        """The task's id."""
        return self.config.task

    def visits(self) -> list[Visits]:
        """States visited in each third of training by the complete runs. Raises UserError."""
        records = {run.seed: run.records for run in self.runs}
        return self.source.visits(self.folder, self.config, records)

    def trained(self, seeds: Sequence[int]) -> dict[int, list[Episode] | None]:
        """Episodes of the trained policies, by seed; None of one that diverged. UserError."""
        return self.source.trained(self.folder, self.config, seeds)

    def replay(self, run: Run) -> Replay:
        """The episode of highest MCC in each window of a run's training. Raises UserError."""
        return self.source.replay(self.folder, self.config, run.seed, run.records)

    def sessions(self) -> Mapping[str, float]:
        """Seconds that each process trained; empty where nothing says."""
        return {k: v for part in self.parts for k, v in part.source.sessions(part.folder).items()}

    @property
    def seeds(self) -> list[int]:
        """Of the complete runs."""
        return [run.seed for run in self.runs]

    @property
    def one_place(self) -> bool:
        """See the function, of its complete runs."""
        return one_place(self.runs)

    def values(self, measure: str) -> list[float | None]:
        """A measure of each complete run."""
        return [run.measures.get(measure) for run in self.runs]


def read(paths: Sequence[Path], notes: list[str], name: str = "") -> list[Group]:
    """All groups of some folders and archives; those that differ in their seeds alone are one.

    name: that the titles of several paths begin with. Runs that are missing, damaged or unfinished
    go into the notes. Raises UserError where no run is left.
    """
    from agents.results.archive import open_source
    from agents.results.joined import JoinedSource
    from agents.results.pooled import PooledSource

    source = open_source(paths[0]) if len(paths) == 1 else JoinedSource(paths, name)
    pooled = PooledSource(source, notes)
    single = {
        group.folder: replace(
            group,
            title=source.title(group.folder),
            recorded=source.configs[group.folder],
            source=source,
        )
        for group in pooled.by_folder
    }
    groups = []
    for group in pooled.groups:
        parts = [single[part.folder] for part in pooled.parts[group.folder]]
        title = pooled.title(group.folder)
        more = {"title": title, "recorded": parts[0].recorded, "source": pooled, "pooled": parts}
        groups.append(replace(group, **more))
    return groups


def write_archive(path: Path, groups: Sequence[Group]) -> None:
    """Write an archive of all that was read with some groups of `read`."""
    from agents.results import archive

    pooled = groups[0].source
    archive.write_archive(path, pooled.source, pooled.by_folder)


def read_groups(source: Source, notes: list[str]) -> list[Group]:
    """The runs of every folder of a source.

    Those that are missing, damaged or unfinished go into the notes. Raises UserError where no run
    is left.
    """
    groups = []
    notes += [f"left out: {problem}" for problem in source.problems]
    for folder, content in source.configs.items():
        try:
            config = TrainConfig.parse(content, source.title(folder), strict=False)
        except UserError as error:
            notes.append(f"left out: {error}")
            continue
        group = _read_group(source, folder, config)
        groups.append(group)
        notes += _left_out(source.title(folder), group.missing)
    if not groups and not notes:
        raise UserError(f"{source.name} {NO_RUNS}")
    if not any(group.runs for group in groups):
        raise UserError(f"{source.name} holds no complete runs" + "".join(f"; {n}" for n in notes))
    return groups


def _left_out(folder: str, missing: Mapping[int, str]) -> list[str]:
    """A note for each reason, with the seeds that have it."""
    seeds: dict[str, list[int]] = {}
    for seed, why in missing.items():
        seeds.setdefault(why, []).append(seed)
    return [
        f"left out: {folder}/seed-{of[0]}: {why}"
        if len(of) == 1
        else f"left out: {folder}, seeds {', '.join(map(str, of))}: {why}"
        for why, of in seeds.items()
    ]


def _read_group(source: Source, folder: str, config: TrainConfig) -> Group:
    runs, missing = [], {}
    for seed in config.seeds:
        try:
            runs.append(_read_run(source, folder, config, seed))
        except DamagedSource:
            raise
        except UNREADABLE as error:
            missing[seed] = f"{error}"
    return Group(folder, config, runs, missing)


def _read_run(source: Source, folder: str, config: TrainConfig, seed: int) -> Run:
    files = source.run(folder, config, seed)
    _check_records(files.records, config.steps)
    _check_evaluation(files.evaluation)
    data = RunData(files.records, config.steps, files.evaluation)
    return Run(
        seed,
        measured(data, f"{source.title(folder)}/seed-{seed}"),
        int(files.evaluation["episodes"]),
        files.ends,
        files.records,
        _compact(files.evaluation),
        files.ways,
    )


def _compact(evaluation: Mapping[str, Any]) -> dict[str, Any]:
    """An evaluation in a fifth of the memory: values per episode as arrays, and without where the
    episodes end, which `Run.ends` counts."""
    found = dict(evaluation)
    for policy in POLICIES:
        if policy in found:
            found[policy] = {
                name: np.array(value) if isinstance(value, list) else value
                for name, value in found[policy].items()
                if name != "final_observations"
            }
    return found


def _check_records(records: EpisodeRecords, steps: int) -> None:
    """Raise UserError for records that no training of so many steps leaves."""
    last = records.start_step[records.rollout == records.rollout.max()].min()
    if last >= steps:
        raise UserError(f"is damaged: a rollout starts at step {last}, the training has {steps}")


def _check_evaluation(content: Mapping[str, Any]) -> None:
    """Raise UserError for an `evaluation.json` with values that cannot be."""
    episodes = content["episodes"]
    if not isinstance(episodes, int) or isinstance(episodes, bool) or episodes < 1:
        raise UserError(f"evaluation.json is damaged: episodes must be >= 1, got {episodes!r}")
    for policy in POLICIES:
        of = content.get(policy, {})
        for name in {"J_R", "J_C", CVAR} & of.keys():
            value = of[name]
            number = isinstance(value, (int, float)) and not isinstance(value, bool)
            if not number or (name != "J_R" and value < 0):
                raise UserError(
                    f"evaluation.json is damaged: {name} of the {policy} policy is {value!r}"
                )
        if "returns" in of and "cost_returns" in of:
            _check_means(policy, of, episodes)


def _check_means(policy: str, of: Mapping[str, Any], episodes: int) -> None:
    """Raise UserError where the means of a policy are not those of its episodes."""
    returns, costs = (np.array(of[name], dtype=np.float64) for name in ("returns", "cost_returns"))
    if returns.shape != (episodes,) or costs.shape != (episodes,):
        raise UserError(f"evaluation.json is damaged: it must hold {episodes} episodes a policy")
    means = {"J_R": returns.mean(), "J_C": costs.mean(), CVAR: cvar(costs, CVAR_ALPHA)}
    for name, mean in means.items():
        if name in of and not math.isclose(of[name], mean, rel_tol=1e-9, abs_tol=1e-9):
            raise UserError(
                f"evaluation.json is damaged: {name} of the {policy} policy is {of[name]}, its "
                f"episodes give {mean}"
            )
