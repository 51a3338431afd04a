"""Trainings as they are read: their arrays, the runs in them, and groups of runs."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.algorithms import ALGORITHMS
from agents.presets import registered_id
from agents.results import recorded
from agents.results.names import title_of, titled, unusual_settings, unusual_steps
from agents.results.recorded import Recorded
from agents.training import derive
from agents.training.config import CONFIG, RESULTS, TrainConfig
from agents.training.derive import BITS, Drawn, Visits
from agents.training.files import AnyPath, Arrays, content_of, read_json
from emcc import EpisodeRecords
from emcc.arrays import as_array
from emcc.parts import PARTS
from emcc.records import of_digits, unpack_costs

PICTURES = "pictures.npz"
"""The arrays of an archive's training that pictures alone need: see `results.archive`."""


class Episode(NamedTuple):
    """One episode: where each step ended, and what it cost."""

    positions: NDArray[np.float32]
    """[T, 2] in the view's unit; [T + 1, 2], the start first, of a trained policy."""
    costs: NDArray[np.float64]
    """[T]"""


class Highlight(NamedTuple):
    """The episode of highest MCC in a window of training."""

    window: int
    """Which of the `derive.WINDOWS` equal parts of training."""
    start_step: int
    """Environment steps before it."""
    points: NDArray[np.uint16]
    """Where the steps of `derive.shown_states` ended, [K, 2]: see `Highlights.positions`."""
    unsafe: NDArray[np.bool_]
    """Whether each of its steps cost, [T]."""
    cost: float
    """Sum of its costs."""


class Highlights(NamedTuple):
    """Episodes of a run's training, one for each window, on a grid of 1024 points a side."""

    episodes: list[Highlight]
    box: NDArray[np.float64]
    """The lowest and the highest of the points' coordinates in the view's unit, [2, 2]."""

    def positions(self, points: NDArray[np.uint16]) -> NDArray[np.float64]:
        """Points in the view's unit, [T, 2]."""
        return self.box[0] + points * ((self.box[1] - self.box[0]) / (2**BITS - 1))


@dataclass(frozen=True)
class Training:
    """A training's folder, on disk or in an archive, and the runs of one task in it."""

    path: AnyPath
    folder: str
    """Below the report's own: see `Group`."""
    title: str
    """The folder as seen from beside the report's."""
    arrays: Mapping[str, NDArray] = field(repr=False)
    """`results.npz`, or what it would hold by now: see `derive`."""
    config: TrainConfig
    """The folder's config.json."""

    def get(self, name: str, *shape: int) -> NDArray:
        """An array of numbers of a shape, in which -1 is any number. Raises UserError for another,
        naming the file: each array may be whole and not fit the others."""
        in_pictures = name in self.pictures
        with content_of(self.path / (PICTURES if in_pictures else RESULTS)):
            array = as_array((self.pictures if in_pictures else self.arrays)[name], name)
            fits = [n in (-1, size) for n, size in zip(shape, array.shape, strict=False)]
            if len(shape) != array.ndim or not all(fits):
                raise ValueError(f"{name} has shape {list(array.shape)}, expected {list(shape)}")
        return array

    def has(self, name: str) -> bool:
        """Whether there is an array of that name."""
        return name in self.arrays or name in self.pictures

    @cached_property
    def pictures(self) -> Mapping[str, NDArray]:
        """`pictures.npz`, of an archive; of a folder nothing."""
        return Arrays(self.path / PICTURES) if (self.path / PICTURES).is_file() else {}

    @property
    def recorded(self) -> Mapping[str, Any]:
        """`config.json`."""
        return read_json(self.path / CONFIG)

    def visits(self, prefix: str) -> NDArray[np.int64]:
        """Visits of each cell, [3, CELLS, CELLS]: see `Visits`; prefix: of a task's arrays."""
        name, cells = prefix + "visits", derive.CELLS
        if name in self.pictures:
            return of_digits(self.get(name, -1, len(PARTS), cells, cells))
        counts = self.get(name, len(PARTS), -1, -1).astype(np.int64)
        if counts.shape[1:] == (2 * cells, 2 * cells):  # before 0.4
            return counts.reshape(len(PARTS), cells, 2, cells, 2).sum(axis=(2, 4))
        return self.get(name, len(PARTS), cells, cells).astype(np.int64)

    def of_steps(self, name: str, steps: int) -> NDArray[np.float64]:
        """A number of each step of a run, [steps], from the arrays below a name."""
        with content_of(self.path / RESULTS):
            values = unpack_costs(self.arrays, name)
            if len(values) != steps:
                raise ValueError(f"{name} has {len(values)} of {steps} steps")
        return values

    def bits(self, name: str, count: int) -> NDArray[np.bool_]:
        """An array of so many bits."""
        return np.unpackbits(self.get(name, -(-count // 8)), count=count).astype(bool)


@dataclass(frozen=True)
class RunResult:
    """A complete run: what measures are computed from, and these."""

    seed: int
    measures: Mapping[str, float | None]
    """By the name of the measure; None for what the run lacks."""
    episodes: int
    """Evaluation episodes per policy."""
    ends: Mapping[str, int]
    """Evaluated episodes of the deterministic policy by the place where they end; empty for a task
    without named places."""
    records: EpisodeRecords = field(repr=False)
    """A row per training episode."""
    evaluation: Mapping[str, Mapping[str, Any]] = field(default_factory=dict, repr=False)
    """For each policy, "deterministic" and "stochastic", the means J_R, J_C and CVaR_0.5, and
    arrays "returns", "cost_returns" and "lengths" of its episodes, undiscounted."""
    ways: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    """Evaluated episodes by place and way to it; empty for a task without named ways."""
    window: int | None = None
    """Episodes of the windows over which EMCC is taken; None for rollouts."""
    training: Training | None = field(default=None, repr=False)
    """The one it is of, which has what pictures and tables of recorded numbers show."""
    prefix: str = ""
    """The beginning of the names of its arrays there."""

    @property
    def total_steps(self) -> int:
        """Environment steps that it took: those asked for, and the rest of its last epoch."""
        return self.records.total_steps

    @property
    def rollouts(self) -> EpisodeRecords:
        """The records by whose rollouts, or windows, EMCC is taken."""
        return self.records.windows(self.window)

    @cached_property
    def thirds(self) -> dict[float, EpisodeRecords]:
        """The rollouts, or windows, that start in each third of training, by its end."""
        return self.rollouts.by_part(self.total_steps)

    def evaluated(self, name: str) -> float | None:
        """A mean over the episodes of the deterministic policy; None where it was not measured."""
        value = self.evaluation.get("deterministic", {}).get(name)
        return None if value is None else float(value)

    @property
    def end(self) -> str:
        """The place where most of its evaluated episodes end; empty without places."""
        return max(self.ends, key=self.ends.__getitem__, default="")

    @property
    def way(self) -> str:
        """The way by which most of them came to that place; empty where it is unknown."""
        ways = self.ways.get(self.end, {})
        return max(ways, key=ways.__getitem__, default="")

    @property
    def place(self) -> str:
        """Place and way; empty without places."""
        return ", ".join(filter(None, (self.end, self.way)))

    def trained(self) -> list[Drawn] | None:
        """Episodes of its trained policy, which the first `derive.DRAWN_POLICIES` runs have; None
        without positions."""
        own, prefix = self._arrays, f"{self.prefix}trained/"
        if not own.has(prefix + "states"):
            return None
        states = own.get(prefix + "states", -1)
        total, ends = int(states.sum()), np.cumsum(states)[:-1]
        paths = np.split(own.get(prefix + "positions", total, 2), ends)
        return [*map(Drawn, paths, np.split(own.bits(prefix + "unsafe", total), ends))]

    def replay(self) -> Highlights | None:
        """The episode of highest MCC, by the training's first cost, in each window of its training;
        None without positions."""
        own, prefix, records = self._arrays, f"{self.prefix}replay/", self.records
        if not own.has(prefix + "drawn"):
            return None
        windows, rows = zip(*derive.replay_rows(records, self.replay_steps), strict=True)
        length, start = records.length[[*rows]], records.start_step[[*rows]]
        total, ends = int(length.sum()), np.cumsum(length)[:-1]
        shown = [len(derive.shown_states(steps)) for steps in length]
        drawn = derive.path_of(own.get(prefix + "drawn", -1, 2, sum(shown)))
        points = np.split(drawn, np.cumsum(shown)[:-1])
        unsafe = np.split(own.bits(prefix + "unsafe", total), ends)
        told = (windows, start.tolist(), points, unsafe, records.cost[[*rows]].tolist())
        return Highlights([*map(Highlight, *told)], own.get(prefix + "box", 2, 2))

    @property
    def replay_steps(self) -> int:
        """Environment steps that the windows of its replay divide."""
        return max(1, int(self._arrays.get(f"{self.prefix}replay/steps")))

    def recorded(self, name: str) -> Recorded:
        """A number that was recorded at each of its steps."""
        own, prefix = self._arrays, f"{self.prefix}info/{name}/"
        if prefix + "lowest" not in own.arrays:
            values = own.of_steps(prefix, self.total_steps)
            return recorded.of_steps(values, self.records, self.window)
        with content_of(own.path / RESULTS):
            return recorded.unpacked(own.arrays, prefix, self.window)

    @property
    def _arrays(self) -> Training:
        assert self.training is not None
        return self.training


def one_place(runs: Sequence[RunResult]) -> bool:
    """Whether all runs end in the same place by the same way, or the task has no places."""
    return len({run.place for run in runs}) < 2


@dataclass(frozen=True)
class Group:
    """The runs of a training on one task, or of several trainings that differ in seeds alone."""

    folder: str
    """Below the report's own: "." or like "Circle2D-1-v0/cpo"; of several with " + " between."""
    task: str
    """Its id, the longer of two where runs of both are there: see `under_one_id`."""
    config: TrainConfig
    runs: Sequence[RunResult]
    """Complete runs."""
    trainings: Sequence[Training] = field(repr=False)
    missing: Mapping[int, str] = field(default_factory=dict)
    """Why the others are left out, by seed."""
    apart: str = ""
    """Behind the unusual settings: the cost, unless it is the only one, and what `with_names` adds
    for an unregistered algorithm."""
    cost: str = "cost"
    """The cost that its measures are of."""
    printed: Mapping[str, float] = field(default_factory=dict)
    """Printed numbers for its algorithm and task, by measure: see `paper.evidence`."""
    publication: str = ""
    """The publication that prints them, by name, and its number of runs."""
    where: str = ""
    """The folder, where another group has its settings: see `names.with_names`."""
    one_length: bool = False
    """Whether the runs that it is shown beside on a task have one length, which names leave out."""
    place: int | None = None
    """Its place among folders that were given one by one: tables and figures keep their order."""

    @property
    def title(self) -> str:
        """The folders as seen from beside the report's."""
        return " + ".join(own.title for own in self.trainings)

    @property
    def variant(self) -> str:
        """The algorithm, with its settings and length where they are not the usual ones."""
        return title_of(self.config, self.task, self.total_steps)

    @property
    def settings(self) -> str:
        """The settings that are not the usual ones, in words."""
        words = unusual_settings(self.config, self.task)
        words += unusual_steps(self.total_steps, self.task)
        return ", ".join(filter(None, [*words, self.apart]))

    @property
    def length(self) -> list[str]:
        """Its number of steps in words, where a name has to have it."""
        return [] if self.one_length else unusual_steps(self.total_steps, self.task)

    @property
    def name(self) -> str:
        """The algorithm with its settings, as tables and figures have it."""
        settings = unusual_settings(self.config, self.task)
        return titled(self.config.algorithm, [*settings, *self.length, self.apart, self.where])

    @property
    def full_name(self) -> str:
        """The name with the number of steps, unless it is the usual one, as files of numbers have
        it."""
        return dataclasses.replace(self, one_length=False).name

    @property
    def seeds(self) -> list[int]:
        """Seeds of the complete runs."""
        return [run.seed for run in self.runs]

    @property
    def total_steps(self) -> int:
        """Environment steps of its longest run: see `derive.told_steps`."""
        return derive.told_steps(self.config.steps, (run.total_steps for run in self.runs))

    @property
    def off_policy(self) -> bool:
        """Whether its algorithm learns from a replay, an episode at a time. Of one that is not
        registered here a hyper-parameter tells it."""
        name = self.config.algorithm
        if name in ALGORITHMS:
            return ALGORITHMS[name].off_policy
        return hasattr(self.config.hyperparameters, "replay_size")

    @property
    def is_of_first_cost(self) -> bool:
        """Whether its cost is the training's first, of which visits, trained policies and replay
        are."""
        return self.cost == self.config.costs[0]

    @property
    def one_place(self) -> bool:
        """Whether all complete runs end in one place."""
        return one_place(self.runs)

    def values(self, measure: str) -> list[float | None]:
        """A measure of each complete run."""
        return [run.measures.get(measure) for run in self.runs]

    @property
    def limit(self) -> float | None:
        """The limit of its cost; None where the algorithm does not limit it."""
        return self.config.limits.get(self.cost)

    @property
    def _prefix(self) -> str:
        """The beginning of the names of its task's arrays, from the id that its trainings have."""
        return self.runs[0].prefix.rsplit("/", 2)[0] + "/"

    def visits(self) -> list[Visits] | None:
        """Visited states by third of training, of all complete runs, of which there is one; None
        without positions."""
        prefix, parts = self._prefix, []
        for own in self.trainings:
            has_runs = not set(self.seeds).isdisjoint(own.config.seeds)
            if has_runs and not own.has(prefix + "visits"):
                return None
            if has_runs:
                parts.append((own.visits(prefix), own.get(prefix + "visited", len(PARTS), 3)))
        counts = np.sum([counts for counts, _ in parts], axis=0)
        about = np.array([about for _, about in parts])  # [parts, thirds, (EMCC, rollouts, of)]
        rollouts = about[..., 1:].sum(axis=0).astype(int).tolist()
        # From the costs: before 0.4 archives have EMCC with all ties.
        emcc = np.mean([[*r.records.emcc_by_part().values()] for r in self.runs], axis=0)
        thirds = zip(counts, emcc.tolist(), rollouts, strict=True)
        return [Visits(visited, value, *number) for visited, value, number in thirds]

    @property
    def recorded(self) -> dict[str, str]:
        """Units of what its task has recorded at each step, by name."""
        with content_of(self.trainings[0].path / RESULTS):
            names = self.trainings[0].arrays.get(self._prefix + "info", np.empty((0, 2), str))
            return dict(names.tolist())


def under_one_id(groups: Sequence[Group]) -> list[Group]:
    """The groups, with one id for each task: of the two that ours have, the longer where groups of
    both are there."""
    there = {group.task for group in groups}
    ids = {task: own for task in there if (own := registered_id(task)) in there}
    return [dataclasses.replace(group, task=ids.get(group.task, group.task)) for group in groups]


def name_of_all(groups: Sequence[Group]) -> str:
    """The name of the folder, archive or report that holds some groups."""
    own = groups[0].trainings[0]
    return own.title if own.folder == "." else own.title.removesuffix(f"/{own.folder}")
