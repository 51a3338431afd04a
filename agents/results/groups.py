"""Trainings read from disk or archives: their arrays, their runs, and groups of runs."""

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
from agents.training.derive import Drawn, Visits
from agents.training.files import AnyPath, Arrays, content_of, read_json
from emcc import EpisodeRecords
from emcc.arrays import as_array
from emcc.parts import PARTS
from emcc.records import of_digits, unpack_costs

PICTURES = "pictures.npz"
"""File of an archived training with the arrays that only pictures need: see `results.archive`."""


class Episode(NamedTuple):
    """Position and cost of each step of an episode."""

    positions: NDArray[np.float32]
    """Where each step ended, [T, 2], in the view's unit; for an episode of a trained policy
    [T + 1, 2], the start first."""
    costs: NDArray[np.float64]
    """[T]"""


class Highlights(NamedTuple):
    """The episode with the highest MCC in each window of a run's training."""

    windows: list[int]
    """Index of each episode's window, one of `derive.WINDOWS` equal parts of training."""
    episodes: EpisodeRecords
    """A row for each episode."""
    points: NDArray[np.uint16]
    """Where the steps in `derive.shown_states` ended, [K, 2], one episode after the other, on a
    grid of 1024 x 1024 points."""
    unsafe: NDArray[np.bool_]
    """Whether each step cost, one episode after the other."""
    box: NDArray[np.float64]
    """Lowest and highest coordinates of the points, in the view's unit, [2, 2]."""


@dataclass(frozen=True)
class Training:
    """A training's folder, on disk or in an archive."""

    path: AnyPath
    folder: str
    """Path of the folder relative to the report's: see `Group`."""
    title: str
    """Path of the folder relative to the parent of the report's."""
    arrays: Mapping[str, NDArray] = field(repr=False)
    """`results.npz`; for a training in progress, what the file would hold now: see `derive`."""
    config: TrainConfig
    """Settings from the folder's config.json."""

    def get(self, name: str, *shape: int) -> NDArray:
        """Read an array and check its dtype and shape; -1 in `shape` accepts any length. Raises
        UserError naming the file: an array can be undamaged and still not match the others."""
        in_pictures = name in self.pictures
        with content_of(self.path / (PICTURES if in_pictures else RESULTS)):
            array = as_array((self.pictures if in_pictures else self.arrays)[name], name)
            fits = [n in (-1, size) for n, size in zip(shape, array.shape, strict=False)]
            if len(shape) != array.ndim or not all(fits):
                raise ValueError(f"{name} has shape {list(array.shape)}, expected {list(shape)}")
        return array

    def has(self, name: str) -> bool:
        """Whether there is an array with this name."""
        return name in self.arrays or name in self.pictures

    @cached_property
    def pictures(self) -> Mapping[str, NDArray]:
        """Arrays of `pictures.npz` in an archive; empty for a folder on disk."""
        return Arrays(self.path / PICTURES) if (self.path / PICTURES).is_file() else {}

    @property
    def recorded(self) -> Mapping[str, Any]:
        """Content of `config.json`."""
        return read_json(self.path / CONFIG)

    def visits(self, prefix: str) -> NDArray[np.int64]:
        """Return visits of each cell by third, [3, CELLS, CELLS]: see `Visits`.

        prefix: of the names of a task's arrays."""
        name, cells = prefix + "visits", derive.CELLS
        if name in self.pictures:
            return of_digits(self.get(name, -1, len(PARTS), cells, cells))
        counts = self.get(name, len(PARTS), -1, -1).astype(np.int64)
        if counts.shape[1:] == (2 * cells, 2 * cells):  # before 0.4
            return counts.reshape(len(PARTS), cells, 2, cells, 2).sum(axis=(2, 4))
        return self.get(name, len(PARTS), cells, cells).astype(np.int64)

    def of_steps(self, name: str, steps: int) -> NDArray[np.float64]:
        """Return a number recorded at each step of a run, [steps], from the arrays below `name`."""
        with content_of(self.path / RESULTS):
            values = unpack_costs(self.arrays, name)
            if len(values) != steps:
                raise ValueError(f"{name} has {len(values)} of {steps} steps")
        return values

    def bits(self, name: str, count: int) -> NDArray[np.bool_]:
        """Return an array of `count` bits as bools."""
        return np.unpackbits(self.get(name, -(-count // 8)), count=count).astype(bool)


@dataclass(frozen=True)
class RunResult:
    """A complete run: its measures, and the data that they are computed from."""

    seed: int
    measures: Mapping[str, float | None]
    """Values by measure name; None for what the run lacks."""
    episodes: int
    """Evaluation episodes per policy."""
    ends: Mapping[str, int]
    """Number of evaluated episodes of the deterministic policy that end in each place; empty for a
    task without named places."""
    records: EpisodeRecords = field(repr=False)
    """One row per training episode."""
    evaluation: Mapping[str, Mapping[str, Any]] = field(default_factory=dict, repr=False)
    """For each policy, "deterministic" and "stochastic": J_R, J_C and CVaR_0.5 as floats, and
    arrays "returns", "cost_returns" and "lengths" of its episodes, undiscounted."""
    ways: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    """Number of evaluated episodes by place and way to the place; empty for a task without named
    ways."""
    window: int | None = None
    """Episodes per window over which EMCC is taken; None for rollouts."""
    training: Training | None = field(default=None, repr=False)
    """The training of this run, with the arrays for pictures and tables of recorded numbers."""
    prefix: str = ""
    """Prefix of the names of the run's arrays in the training."""

    @property
    def total_steps(self) -> int:
        """Environment steps that the run took: those asked for and the rest of its last epoch."""
        return self.records.total_steps

    @property
    def rollouts(self) -> EpisodeRecords:
        """Records grouped by the rollouts or windows over which EMCC is taken."""
        return self.records.windows(self.window)

    @cached_property
    def thirds(self) -> dict[float, EpisodeRecords]:
        """Rollouts or windows that start in each third of training, by the end of the third."""
        return self.rollouts.by_part(self.total_steps)

    def evaluated(self, name: str) -> float | None:
        """Return a statistic of the deterministic policy's episodes; None if not measured."""
        value = self.evaluation.get("deterministic", {}).get(name)
        return None if value is None else float(value)

    @property
    def end(self) -> str:
        """Place where most evaluated episodes end; empty for a task without named places."""
        return max(self.ends, key=self.ends.__getitem__, default="")

    @property
    def way(self) -> str:
        """Way that most of the episodes ending in that place took; empty if unknown."""
        ways = self.ways.get(self.end, {})
        return max(ways, key=ways.__getitem__, default="")

    @property
    def place(self) -> str:
        """Place and way; empty for a task without named places."""
        return ", ".join(filter(None, (self.end, self.way)))

    def trained(self) -> list[Drawn] | None:
        """Return episodes of the trained policy; None without recorded positions.

        Only the first `derive.DRAWN_POLICIES` runs of a task have them."""
        own, prefix = self._arrays, f"{self.prefix}trained/"
        if not own.has(prefix + "states"):
            return None
        states = own.get(prefix + "states", -1)
        total, ends = int(states.sum()), np.cumsum(states)[:-1]
        paths = np.split(own.get(prefix + "positions", total, 2), ends)
        return [*map(Drawn, paths, np.split(own.bits(prefix + "unsafe", total), ends))]

    def replay(self) -> Highlights | None:
        """Return the episode with the highest MCC in each window of training, by the training's
        first cost; None without recorded positions."""
        own, prefix, records = self._arrays, f"{self.prefix}replay/", self.records
        if not own.has(prefix + "drawn"):
            return None
        windows, rows = zip(*derive.replay_rows(records, self.replay_steps), strict=True)
        episodes = records.select(np.array(rows))
        shown = sum(len(derive.shown_states(steps)) for steps in episodes.length)
        points = derive.path_of(own.get(prefix + "drawn", -1, 2, shown))
        unsafe = own.bits(prefix + "unsafe", int(episodes.length.sum()))
        return Highlights([*windows], episodes, points, unsafe, own.get(prefix + "box", 2, 2))

    @property
    def replay_steps(self) -> int:
        """Environment steps that the windows of the replay divide."""
        return max(1, int(self._arrays.get(f"{self.prefix}replay/steps")))

    def recorded(self, name: str) -> Recorded:
        """Return the statistics of a number that was recorded at each step of the run."""
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
    """Path relative to the report's folder, "." or like "Circle2D-1-v0/cpo"; several folders are
    joined by " + "."""
    task: str
    """Task id; for a task with two ids, see `under_one_id`."""
    config: TrainConfig
    runs: Sequence[RunResult]
    """Complete runs."""
    trainings: Sequence[Training] = field(repr=False)
    missing: Mapping[int, str] = field(default_factory=dict)
    """Why each other run is left out, by seed."""
    apart: str = ""
    """Words after the unusual settings in the name: the cost, unless it is the only one, and what
    `with_names` adds for an unregistered algorithm."""
    cost: str = "cost"
    """The cost that the measures are computed from."""
    printed: Mapping[str, float] = field(default_factory=dict)
    """Published numbers for the algorithm and task, by measure: see `paper.evidence`."""
    publication: str = ""
    """Name of the publication that prints them, and its number of runs."""
    where: str = ""
    """The folder, if another group has the same settings: see `names.with_names`."""
    one_length: bool = False
    """Whether all runs shown together on each task have one length, which names then leave out."""
    place: int | None = None
    """Index among folders that were given one by one: tables and figures keep that order."""

    @property
    def title(self) -> str:
        """Paths of the folders relative to the parent of the report's."""
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
        """The number of steps in words; empty where names leave it out."""
        return [] if self.one_length else unusual_steps(self.total_steps, self.task)

    @property
    def name(self) -> str:
        """The algorithm with its settings, as tables and figures show it."""
        settings = unusual_settings(self.config, self.task)
        return titled(self.config.algorithm, [*settings, *self.length, self.apart, self.where])

    @property
    def full_name(self) -> str:
        """The name with any unusual number of steps, as files of numbers show it."""
        return dataclasses.replace(self, one_length=False).name

    @property
    def seeds(self) -> list[int]:
        """Seeds of the complete runs."""
        return [run.seed for run in self.runs]

    @property
    def total_steps(self) -> int:
        """Environment steps of the longest run: see `derive.told_steps`."""
        return derive.told_steps(self.config.steps, (run.total_steps for run in self.runs))

    @property
    def off_policy(self) -> bool:
        """Whether the algorithm is off-policy: it learns from a replay buffer. If the algorithm is
        not registered here, a hyper-parameter named `replay_size` decides."""
        name = self.config.algorithm
        if name in ALGORITHMS:
            return ALGORITHMS[name].off_policy
        return hasattr(self.config.hyperparameters, "replay_size")

    @property
    def is_of_first_cost(self) -> bool:
        """Whether the cost is the training's first, which visits, trained policies and the replay
        show."""
        return self.cost == self.config.costs[0]

    @property
    def one_place(self) -> bool:
        """Whether all complete runs end in one place: see the function `one_place`."""
        return one_place(self.runs)

    def values(self, measure: str) -> list[float | None]:
        """Return a measure's value for each complete run."""
        return [run.measures.get(measure) for run in self.runs]

    @property
    def limit(self) -> float | None:
        """Limit of the cost; None if the algorithm does not limit it."""
        return self.config.limits.get(self.cost)

    @property
    def _prefix(self) -> str:
        """Prefix of the names of the task's arrays, with the task id that the trainings use."""
        return self.runs[0].prefix.rsplit("/", 2)[0] + "/"

    def visits(self) -> list[Visits] | None:
        """Return the states visited by all complete runs, by third of training; None without
        recorded positions. There must be a complete run."""
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
        # Computed from the costs: archives from before 0.4 hold EMCC with all ties.
        emcc = np.mean([[*r.records.emcc_by_part().values()] for r in self.runs], axis=0)
        thirds = zip(counts, emcc.tolist(), rollouts, strict=True)
        return [Visits(visited, value, *number) for visited, value, number in thirds]

    @property
    def recorded(self) -> dict[str, str]:
        """Units of the numbers that the task recorded at each step, by name."""
        with content_of(self.trainings[0].path / RESULTS):
            names = self.trainings[0].arrays.get(self._prefix + "info", np.empty((0, 2), str))
            return dict(names.tolist())


def under_one_id(groups: Sequence[Group]) -> list[Group]:
    """Return the groups with one id per task: where groups use several ids of a task, one of them
    the registered id, all get the registered one."""
    there = {group.task for group in groups}
    ids = {task: own for task in there if (own := registered_id(task)) in there}
    return [dataclasses.replace(group, task=ids.get(group.task, group.task)) for group in groups]


def name_of_all(groups: Sequence[Group]) -> str:
    """Return the name of the folder, archive or report that holds the groups."""
    own = groups[0].trainings[0]
    return own.title if own.folder == "." else own.title.removesuffix(f"/{own.folder}")
