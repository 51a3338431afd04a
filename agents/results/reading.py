"""Trained runs as reports see them: from folders and archives, by task, and which are complete.

An archive is a folder of trainings as a zip file: see `agents.results.archive`. Nothing in it is
unpickled, and reading it runs no code of others.
"""

from __future__ import annotations

import itertools
import zipfile
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.algorithms import ALGORITHMS
from agents.errors import OwnCodeError, UserError
from agents.results import recorded
from agents.results.measures import measured
from agents.results.names import title_of, titled, unusual_settings
from agents.results.recorded import Recorded
from agents.training import derive
from agents.training.config import (
    CHECKPOINTS,
    CONFIG,
    NO_RUNS,
    RESULTS,
    RunId,
    TrainConfig,
    file_name,
)
from agents.training.derive import BITS, Drawn, Visits
from agents.training.evaluation import POLICIES
from agents.training.files import (
    UNREADABLE,
    AnyPath,
    Arrays,
    archive_of,
    content_of,
    numbered,
    opened,
    read_json,
)
from emcc import CostRecorder, EpisodeRecords, cvar
from emcc.arrays import as_array
from emcc.npz import open_zip
from emcc.parts import PARTS
from emcc.records import of_digits, records_of, unpack_costs

CVAR_ALPHA = 0.5
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

    def visits(self, task: str) -> NDArray[np.int64]:
        """Visits of each cell, [3, CELLS, CELLS]: see `Visits`."""
        name, cells = file_name(task) + "/visits", derive.CELLS
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
    """Of the names of its arrays there."""

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
        words = unusual_settings(self.config, self.task, self.total_steps)
        return ", ".join(filter(None, [*words, self.apart]))

    @property
    def name(self) -> str:
        """The algorithm with its settings, as tables have it."""
        return titled(self.config.algorithm, [self.settings, self.where])

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

    def visits(self) -> list[Visits] | None:
        """Visited states by third of training, of all complete runs; None without positions."""
        prefix, parts = file_name(self.task) + "/", []
        for own in self.trainings:
            has_runs = not set(self.seeds).isdisjoint(own.config.seeds)
            if has_runs and not own.has(prefix + "visits"):
                return None
            if has_runs:
                parts.append((own.visits(self.task), own.get(prefix + "visited", len(PARTS), 3)))
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
            names = self.trainings[0].arrays.get(
                file_name(self.task) + "/info", np.empty((0, 2), str)
            )
            return dict(names.tolist())


class LeftOut(str):
    """A note on runs, or on a part of a report, that had to be left out."""


def left_out(what: str, groups: Sequence[Group], error: UserError) -> LeftOut:
    """A note on what of some groups a report cannot show, since its arrays are damaged."""
    words = str(error)
    for training in (own for group in groups for own in group.trainings):
        words = _relative(words, training.path, training.title)
    titles = ", ".join(dict.fromkeys(group.title for group in groups))
    return LeftOut(f"left out: {what} of {titles}: {words}")


def read_groups(
    paths: Sequence[Path],
    notes: list[str],
    name: str | None = None,
    window: int | None = None,
) -> list[Group]:
    """The runs at or below some folders and in archives, by task; a path may lead into an archive.

    Folders that differ in their seeds alone count as one. What is missing, damaged or unfinished
    goes into the notes. name: of what holds all, by default that of the only path. window: episodes
    of EMCC's windows, by default rollouts. Raises UserError where no run is left, for a window
    below 1, for a path that is no folder or archive, and where one lies in another.
    """
    if window is not None and window < 1:
        raise UserError(f"window must be at least 1 episode, got {window}")
    sources = _folders(paths, name)
    own = name if name is not None else name_of_source(paths[0])
    groups = []
    for folder, path in sources.items():
        title = own if folder == "." else f"{own}/{folder}"
        try:
            groups += _groups(path, folder, title, window)
        except OwnCodeError:
            raise
        except UserError as error:
            notes.append(LeftOut(f"left out: {_relative(error, path, title)}"))
    if not groups and not notes:
        raise UserError(f"{own} {NO_RUNS}")
    for group in groups:
        notes += _left_out(group.title, group.missing)
        if empty := [f"EMCC_{part}" for part in PARTS if None in group.values(f"EMCC_{part}")]:
            unit = "window" if window else "rollout"
            words = f"of its {group.total_steps:,} steps no {unit} starts in that part"
            notes.append(f"{group.title} has no {', '.join(empty)}: {words}")
    if not any(group.runs for group in groups):
        raise UserError(f"{own} holds no complete runs" + "".join(f"; {note}" for note in notes))
    return _pooled(groups, notes)


def read_folder(path: Path, name: str) -> list[Group]:
    """The runs of one training. Raises UserError where none is complete."""
    groups = _groups(opened(path), name, name, None)
    if not any(group.runs for group in groups):
        reasons = "; ".join(note for group in groups for note in _left_out(name, group.missing))
        raise UserError(f"{name} holds no complete runs; {reasons}")
    return groups


def name_of_source(path: Path) -> str:
    """The name of a folder; of an archive that of the folder it was made from."""
    archive = archive_of(path)
    if archive is None:
        return path.resolve().name
    within = path.relative_to(archive).as_posix()
    if within != ".":
        return PurePosixPath(within).name
    with zipfile.ZipFile(archive) as file:
        return file.comment.decode(errors="replace") or archive.stem


def folders_below(path: Path) -> dict[str, AnyPath]:
    """Folders of trainings at or below a folder, in an archive, or in a folder of an archive, such
    as `runs.zip/Circle2D-1-v0`, by their names from there. Raises UserError for anything else."""
    archive = archive_of(path)
    if archive is None:
        if not path.is_dir():
            raise UserError(f"{path} is no folder")
        files = sorted(path.rglob(CONFIG))
        return {file.parent.relative_to(path).as_posix(): file.parent for file in files}
    within = path.relative_to(archive)
    try:
        root = zipfile.Path(open_zip(archive))
        names = [PurePosixPath(name) for name in root.root.namelist()]
    except UNREADABLE as error:
        raise UserError(f"{path} is no archive that circle2d report wrote: {error}") from None
    folders = [name.parent for name in names if name.name == CONFIG]
    if not folders:
        raise UserError(f"{archive} is no archive that circle2d report wrote: no {CONFIG} in it")
    below = [folder for folder in folders if folder.is_relative_to(within)]
    if not below:
        beside = sorted({f.parts[0] for f in folders if f.parts})
        raise UserError(f"{archive} has no folder {within}; it has {', '.join(beside) or 'none'}")
    return {
        folder.relative_to(within).as_posix(): root if str(folder) == "." else root / str(folder)
        for folder in below
    }


def _folders(paths: Sequence[Path], name: str | None) -> dict[str, AnyPath]:
    """All folders of trainings by a name each.

    A folder keeps its name where no other path has one of that name; otherwise, and where it is all
    of its path (`.`), the path stands before it: as many of its last parts as tell the paths apart.
    """
    for one, other in itertools.permutations(paths, 2):
        if one.resolve().is_relative_to(other.resolve()):
            raise UserError(f"{one} is in {other}: its runs would count twice")
    sources = [folders_below(path) for path in paths]
    for path, folders in zip(paths, sources, strict=True):
        if not folders:
            raise UserError(f"{path} {NO_RUNS}")
    if len(paths) == 1 and name is None:
        return sources[0]
    count = Counter(folder for folders in sources for folder in folders)
    joined: dict[str, AnyPath] = {}
    for prefix, folders in zip(_prefixes(paths), sources, strict=True):
        for folder, path in folders.items():
            unique = count[folder] == 1 and folder != "."
            key = folder if unique else prefix if folder == "." else f"{prefix}/{folder}"
            if key in joined:
                raise UserError(f"two of the sources hold runs named {key}: rename one")
            joined[key] = path
    return joined


def _prefixes(paths: Sequence[Path]) -> list[str]:
    """The last parts of each path, without an archive's suffix: as few as differ, all equally many.

    An archive's suffix stays where nothing else differs.
    """
    resolved = [path.resolve() for path in paths]
    short = [path.with_suffix("") if path.is_file() else path for path in resolved]
    for named in (short, resolved):
        for parts in range(1, max(len(path.parts) for path in named) + 1):
            prefixes = ["/".join(path.parts[-parts:]) for path in named]
            if len(set(prefixes)) == len(paths):
                return prefixes
    raise AssertionError(f"equal paths: {paths}")


def results_of(path: AnyPath, config: TrainConfig) -> Mapping[str, NDArray]:
    """`results.npz` of a training, or what it would hold by now. Raises UserError."""
    if (path / RESULTS).is_file() or not isinstance(path, Path):
        return Arrays(path / RESULTS)
    checkpoints = list(numbered(path, CHECKPOINTS).values())
    failures = Arrays(checkpoints[-1]).get("failures") if checkpoints else None
    return derive.derived(path, config, failures)


def _groups(path: AnyPath, folder: str, title: str, window: int | None) -> list[Group]:
    """The runs of a folder: a group for each task and cost."""
    config = TrainConfig.parse(read_json(path / CONFIG), title, strict=False)
    training = Training(path, folder, title, results_of(path, config), config)
    groups = []
    for task, cost in itertools.product(config.tasks, config.costs):
        runs, missing = [], {}
        for seed in config.seeds:
            try:
                runs.append(_read_run(training, RunId(task, seed), cost, window))
            except OwnCodeError:
                raise
            except UserError as error:
                missing[seed] = _relative(error, path, title)
        apart = "" if cost == config.costs[0] == "cost" else cost
        groups.append(Group(folder, task, config, runs, [training], missing, apart, cost))
    return groups


def _relative(error: object, path: AnyPath, title: str) -> str:
    """An error's words with paths as seen from beside the report's folder: they name no machine."""
    return str(error).replace(str(path), title)


def _left_out(folder: str, missing: Mapping[int, str]) -> list[LeftOut]:
    """A note for each reason, with the seeds that have it."""
    seeds: dict[str, list[int]] = {}
    for seed, why in missing.items():
        seeds.setdefault(why, []).append(seed)
    return [
        LeftOut(f"left out: {folder}, seed{'s' * (len(those) > 1)} {_list(those)}: {why}")
        for why, those in seeds.items()
    ]


def _list(seeds: Sequence[int]) -> str:
    return ", ".join(map(str, seeds))


def run_records(arrays: Mapping[str, NDArray], run: RunId, cost: str) -> EpisodeRecords:
    """Episodes of a run so far, none of one that failed in its first epoch. Raises UserError where
    there is no checkpoint yet, or they are damaged."""
    if f"{run.prefix}length" not in arrays:
        if f"{run.prefix}failure" in arrays:
            return CostRecorder(1).records
        raise UserError("has no checkpoint yet")
    try:
        return records_of(arrays, run.prefix, cost)
    except UserError:
        raise
    except UNREADABLE as error:
        raise UserError(f"is damaged: {error}") from None


def _read_run(training: Training, run: RunId, cost: str, window: int | None) -> RunResult:
    """A complete run. Raises UserError for another."""
    arrays, config = training.arrays, training.config
    if f"{run.prefix}failure" in arrays:
        raise UserError(str(arrays[f"{run.prefix}failure"]))
    records = run_records(arrays, run, cost)
    if records.total_steps < config.steps:
        raise UserError(f"unfinished: {records.total_steps} of {config.steps} steps")
    try:
        evaluation = _evaluation(arrays, run, config.costs.index(cost))
        if not evaluation:
            raise UserError(derive.why_failed(arrays, run))
        ends, ways = _places(arrays, f"{run.prefix}evaluation/deterministic/")
        episodes = len(evaluation["deterministic"]["returns"])
        found = RunResult(
            seed=run.seed,
            measures={},
            episodes=episodes,
            ends=ends,
            records=records,
            evaluation=evaluation,
            ways=ways,
            window=window,
            training=training,
            prefix=run.prefix,
        )
        found = replace(found, measures=measured(found, f"{training.title}, {run}"))
        if ends and sum(ends.values()) != episodes:
            raise ValueError(f"{episodes} evaluated episodes end in {sum(ends.values())} places")
    except UserError:
        raise
    except UNREADABLE as error:
        raise UserError(f"is damaged: {error}") from None
    return found


def _evaluation(arrays: Mapping[str, NDArray], run: RunId, cost: int) -> dict[str, dict[str, Any]]:
    """Means and values per episode of each policy that was evaluated."""
    evaluation: dict[str, dict[str, Any]] = {}
    for policy in POLICIES:
        prefix = f"{run.prefix}evaluation/{policy}/"
        if prefix + "returns" in arrays:
            returns, costs = arrays[prefix + "returns"], arrays[prefix + "costs"][:, cost]
            lengths = arrays[prefix + "lengths"]
            if not returns.shape == costs.shape == lengths.shape or returns.ndim != 1:
                shapes = f"{returns.shape}, {costs.shape} and {lengths.shape}"
                raise ValueError(f"returns, costs and lengths of episodes have shapes {shapes}")
            evaluation[policy] = {
                "J_R": float(np.mean(returns)),
                "J_C": float(np.mean(costs)),
                f"CVaR_{CVAR_ALPHA:g}": cvar(costs, CVAR_ALPHA),
                "returns": returns,
                "cost_returns": costs,
                "lengths": lengths,
            }
    return evaluation if "deterministic" in evaluation else {}


def _places(
    arrays: Mapping[str, NDArray], prefix: str
) -> tuple[dict[str, int], dict[str, dict[str, int]]]:
    """Episodes by the place where they end, and those of each place by the way to it."""
    if prefix + "places" not in arrays:
        return {}, {}
    places = arrays[prefix + "places"].tolist()
    by_way = arrays[prefix + "ways"].tolist() if prefix + "ways" in arrays else [""] * len(places)
    ways: dict[str, dict[str, int]] = {}
    for (place, way), count in Counter(zip(places, by_way, strict=True)).items():
        if way:
            ways.setdefault(place, {})[way] = count
    return dict(Counter(places)), ways


def _pooled(groups: Sequence[Group], notes: list[str]) -> list[Group]:
    """The groups, those that differ in their seeds alone as one, which is noted.

    A group stays alone where one of these has a seed that another has too: one of the two is a
    second training of the same runs, which must not count twice.
    """
    settings, alike = [], []
    for group in groups:
        own = _settings(group)
        if own not in settings:
            settings.append(own)
            alike.append([])
        alike[settings.index(own)].append(group)
    pooled = []
    for same in alike:
        seeds = [seed for group in same for seed in group.config.seeds]
        if len(same) == 1 or len(set(seeds)) < len(seeds):
            pooled += same
            continue
        same.sort(key=lambda group: group.config.seeds)
        pooled.append(
            replace(
                same[0],
                folder=" + ".join(group.folder for group in same),
                config=replace(same[0].config, seeds=tuple(seeds)),
                runs=[run for group in same for run in group.runs],
                trainings=[training for group in same for training in group.trainings],
                missing={seed: why for group in same for seed, why in group.missing.items()},
            )
        )
        listed = (f"{g.title} (seeds {_list(g.config.seeds)})" for g in same)
        notes.append(f"of equal settings, with other seeds, so counted as one: {'; '.join(listed)}")
    return pooled


def _settings(group: Group) -> tuple[Any, ...]:
    """Key under which groups are pooled: everything but the seeds; 5 equals 5.0."""
    config = group.config
    training = (config.algorithm, config.steps, config.costs, config.task_parameters)
    return group.task, group.cost, *training, asdict(config.hyperparameters)


def name_of_all(groups: Sequence[Group]) -> str:
    """The name of the folder, archive or report that holds some groups."""
    own = groups[0].trainings[0]
    return own.title if own.folder == "." else own.title.removesuffix(f"/{own.folder}")
