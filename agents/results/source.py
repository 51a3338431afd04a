"""Sources of results: a folder with runs at or below it; `archive` has the other kind."""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from agents.errors import UserError
from agents.results import steps
from agents.results.steps import Episode, Replay, Visits
from agents.training.config import FAILURE, TrainConfig, run_folder
from agents.training.environments import view_of
from agents.training.files import read_json
from agents.training.status import sessions
from circle2d_mj.core.view import TellsWays, View
from emcc import EpisodeRecords


class DamagedSource(UserError):
    """A source that cannot be read as a whole, whatever single runs lack."""


class RunFiles(NamedTuple):
    """The records of one run."""

    records: EpisodeRecords
    evaluation: dict[str, Any]
    """`evaluation.json`."""
    ends: dict[str, int]
    """Evaluated episodes of the deterministic policy by the place where they end."""
    ways: dict[str, dict[str, int]]
    """Of each place, by the way to it, where the task tells ways: see `view.TellsWays`."""


class StepSource(Protocol):
    """The steps of runs, from which pictures are drawn."""

    def title(self, folder: str) -> str:
        """A folder as seen from beside the source's."""
        ...

    def visits(
        self, folder: str, config: TrainConfig, records: Mapping[int, EpisodeRecords]
    ) -> list[Visits]:
        """States visited in each third of training, of runs by seed. Raises UserError."""
        ...

    def trained(
        self, folder: str, config: TrainConfig, seeds: Sequence[int]
    ) -> dict[int, list[Episode] | None]:
        """Episodes of the trained policies, by seed; None of one that diverged. UserError.

        seeds: an archive has the first `DRAWN_POLICIES` complete ones.
        """
        ...

    def replay(
        self, folder: str, config: TrainConfig, seed: int, records: EpisodeRecords
    ) -> Replay:
        """The episode of highest MCC in each window of training. Raises UserError."""
        ...


class Source(StepSource, Protocol):
    """All that a report reads. Folders are named from the source's own: "." or "a/b"."""

    name: str
    """Of the folder that holds all of them."""
    configs: Mapping[str, dict[str, Any]]
    """`config.json` of each folder of runs, in the order of the report."""
    problems: Sequence[str]
    """Folders that cannot be read, and why."""

    def sessions(self, folder: str) -> Mapping[str, float]:
        """Seconds that each process trained a folder; empty where nothing says."""
        ...

    def run(self, folder: str, config: TrainConfig, seed: int) -> RunFiles:
        """Read a run. Raises UserError where it failed, is unfinished, missing or damaged."""
        ...

    def costs(self, folder: str, seed: int, records: EpisodeRecords) -> NDArray[np.float64]:
        """Costs of all steps of a run, [steps]. Raises UserError."""
        ...


class FolderSource:
    """Runs in a folder, or in several such folders below it. Raises UserError without a folder."""

    def __init__(self, root: Path) -> None:
        if not root.is_dir():
            raise UserError(f"{root} is no folder")
        # Resolved: errors name files relative to it, and "." is in every sentence.
        self.root = root = root.resolve()
        self.name = root.name
        self._trained: dict[tuple[str, int], list[Episode] | None] = {}
        self._views: dict[str, View | None] = {}
        configs: dict[str, dict[str, Any]] = {}
        problems: list[str] = []
        for path in sorted(root.rglob("config.json")):
            try:
                content = read_json(path, checked=True)
            except UserError as error:
                problems.append(self._relative(error))
                continue
            if "seed" not in content:  # that of a single run has one seed
                configs[path.parent.relative_to(root).as_posix()] = content
        self.configs: Mapping[str, dict[str, Any]] = configs
        self.problems: Sequence[str] = problems

    def title(self, folder: str) -> str:
        """A folder as seen from beside the source's."""
        return title(self.name, folder)

    def sessions(self, folder: str) -> Mapping[str, float]:
        """Seconds that each process trained a folder; empty where nothing says."""
        return sessions(self.root / folder)

    def run(self, folder: str, config: TrainConfig, seed: int) -> RunFiles:
        """Read a run. Raises UserError where it failed, is unfinished, missing or damaged."""
        path = run_folder(self.root / folder, seed)
        try:
            if (path / FAILURE).exists():
                step = read_json(path / FAILURE)["step"]
                raise UserError(f"failed at step {step}: it met a NaN or an infinite number")
            if not (path / "episodes.csv").exists():
                raise UserError("has no checkpoint yet")
            records = EpisodeRecords.load(path / "episodes.csv")
            if records.total_steps < config.steps:
                raise UserError(f"is unfinished: {records.total_steps} of {config.steps} steps")
            evaluation = read_json(path / "evaluation.json", checked=True)
        except (ValueError, OSError) as error:
            raise UserError(self._relative(error)) from None
        return RunFiles(records, evaluation, *count_ends(self._view(config), evaluation))

    def _view(self, config: TrainConfig) -> View | None:
        """The view of the task of some runs, made once for each task.

        None of a task that cannot be made, too: it is needed for places and pictures alone, and
        `Scenes` tells why they lack.
        """
        key = repr((config.task, config.task_parameters))
        if key not in self._views:
            self._views[key] = None
            with contextlib.suppress(UserError):
                self._views[key] = view_of(config.task, config.task_parameters)
        return self._views[key]

    def visits(
        self, folder: str, config: TrainConfig, records: Mapping[int, EpisodeRecords]
    ) -> list[Visits]:
        """States visited in each third of training, of runs by seed. Raises UserError."""
        of, view = replace(config, seeds=tuple(records)), self._view(config)
        try:
            return steps.count_visits(self.root / folder, of, list(records.values()), view=view)
        except UserError as error:
            raise UserError(self._relative(error)) from None

    def trained(
        self, folder: str, config: TrainConfig, seeds: Sequence[int]
    ) -> dict[int, list[Episode] | None]:
        """Episodes of the trained policies, by seed; None of one that diverged. UserError."""
        new = [seed for seed in seeds if (folder, seed) not in self._trained]
        if new:
            try:
                view = self._view(config)
                played = steps.play_trained(self.root / folder, config, new, view=view)
            except UserError as error:
                raise UserError(self._relative(error)) from None
            self._trained |= {(folder, seed): of_run for seed, of_run in played.items()}
        return {seed: self._trained[folder, seed] for seed in seeds}

    def costs(self, folder: str, seed: int, records: EpisodeRecords) -> NDArray[np.float64]:
        """Costs of all steps of a run, [steps]. Raises UserError."""
        try:
            return steps.read_costs(run_folder(self.root / folder, seed), records)
        except UserError as error:
            raise UserError(self._relative(error)) from None

    def replay(
        self, folder: str, config: TrainConfig, seed: int, records: EpisodeRecords
    ) -> Replay:
        """The episode of highest MCC in each window of training. Raises UserError."""
        try:
            return steps.replay(run_folder(self.root / folder, seed), config, records)
        except UserError as error:
            raise UserError(self._relative(error)) from None

    def _relative(self, error: Exception) -> str:
        """An error's words with paths as seen from beside the folder: reports name no machine."""
        return str(error).replace(str(self.root), self.name)


def title(name: str, folder: str) -> str:
    """A folder below `name`, as seen from beside it."""
    return name if folder == "." else f"{name}/{folder}"


def count_ends(
    view: View | None, evaluation: dict[str, Any]
) -> tuple[dict[str, int], dict[str, dict[str, int]]]:
    """Evaluated episodes of the deterministic policy by the place where they end, and those of each
    place by the way to it."""
    evaluated = evaluation.get("deterministic", {})
    last = evaluated.get("final_observations")
    if view is None or not last:
        return {}, {}
    left, right, bottom, top = view.extent
    middle = np.array([[(left + right) / 2, (bottom + top) / 2]])
    if not view.places(middle):  # the task's places have no names
        return {}, {}
    positions = view.positions(np.array(last), {})
    places = view.places(positions)
    ways: dict[str, dict[str, int]] = {}
    costs = evaluated.get("cost_returns")
    if costs and isinstance(view, TellsWays):
        for place, way in zip(places, view.ways(positions, np.array(costs)), strict=True):
            if way:
                of_place = ways.setdefault(place, {})
                of_place[way] = of_place.get(way, 0) + 1
    return dict(Counter(places)), ways
