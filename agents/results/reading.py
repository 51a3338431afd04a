"""Read trained runs from folders and archives, group them by task, and tell which are complete.

An archive is a folder of trainings as a zip file: see `agents.results.archive`. Reading an archive
unpickles nothing and runs no foreign code.
"""

from __future__ import annotations

import itertools
import zipfile
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.errors import OwnCodeError, UserError
from agents.results.groups import Group, RunResult, Training, under_one_id
from agents.results.measures import measured
from agents.training import derive
from agents.training.config import CHECKPOINTS, CONFIG, NO_RUNS, RESULTS, RunId, TrainConfig
from agents.training.evaluation import POLICIES
from agents.training.files import (
    UNREADABLE,
    AnyPath,
    Arrays,
    archive_of,
    numbered,
    opened,
    read_json,
)
from emcc import CostRecorder, EpisodeRecords, cvar
from emcc.npz import open_zip
from emcc.parts import PARTS
from emcc.records import records_of

CVAR_ALPHA = 0.5


class LeftOut(str):
    """A note on runs, or on a part of a report, that were left out."""


def left_out(what: str, groups: Sequence[Group], error: UserError) -> LeftOut:
    """Return a note that a report cannot show `what` for the groups, whose arrays are damaged."""
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
    """Read the runs in folders (searched downwards) and archives; group them by task and cost.

    Folders that differ only in their seeds count as one. paths: may lead into an archive. notes:
    gets an entry for whatever is missing, damaged or unfinished. name: of the whole, by default the
    name of the only path. window: episodes per window for EMCC, by default rollouts. Raises
    UserError if no run is left, for a window below 1, for a path that is neither folder nor
    archive, and if one path lies in another.
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
    notes[:] = dict.fromkeys(notes)  # several costs repeat them
    if not any(group.runs for group in groups):
        raise UserError(f"{own} holds no complete runs" + "".join(f"; {note}" for note in notes))
    pooled = under_one_id(_pooled(groups, notes))
    if len(sources) == len(paths) > 1:  # each path is one training
        return [replace(group, place=place) for place, group in enumerate(pooled)]
    return pooled


def read_folder(path: Path, name: str) -> list[Group]:
    """Read the runs of one training. Raises UserError if no run is complete."""
    groups = _groups(opened(path), name, name, None)
    if not any(group.runs for group in groups):
        reasons = (note for group in groups for note in _left_out(name, group.missing))
        reasons = "; ".join(dict.fromkeys(reasons))
        raise UserError(f"{name} holds no complete runs; {reasons}")
    return groups


def name_of_source(path: Path) -> str:
    """Return the name of a folder; for an archive, the name of the folder it was made from."""
    archive = archive_of(path)
    if archive is None:
        return path.resolve().name
    within = path.relative_to(archive).as_posix()
    if within != ".":
        return PurePosixPath(within).name
    with zipfile.ZipFile(archive) as file:
        return file.comment.decode(errors="replace") or archive.stem


def folders_below(path: Path) -> dict[str, AnyPath]:
    """Return the training folders at or below `path`, by relative path.

    path: a folder, an archive, or a folder in an archive, such as `runs.zip/Circle2D-1-v0`. Raises
    UserError for anything else."""
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
        raise UserError(f"{path} is not an archive by circle2d report: {error}") from None
    folders = [name.parent for name in names if name.name == CONFIG]
    if not folders:
        raise UserError(f"{archive} is not an archive by circle2d report: no {CONFIG} in it")
    below = [folder for folder in folders if folder.is_relative_to(within)]
    if not below:
        beside = sorted({f.parts[0] for f in folders if f.parts})
        raise UserError(f"{archive} has no folder {within}; it has {', '.join(beside) or 'none'}")
    return {
        folder.relative_to(within).as_posix(): root if str(folder) == "." else root / str(folder)
        for folder in below
    }


def _folders(paths: Sequence[Path], name: str | None) -> dict[str, AnyPath]:
    """Return all training folders by a unique name.

    A folder keeps its name if no other path has a folder of that name. Otherwise, and if the folder
    is the path itself (`.`), the name begins with the fewest last parts that tell the paths apart.
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
    """Return the last parts of each path: the smallest number, the same for all, that differ.

    An archive's suffix is left out unless nothing else differs.
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
    """Return the arrays of a training's `results.npz`, or what the file would hold now.

    Raises UserError if they cannot be read."""
    if (path / RESULTS).is_file() or not isinstance(path, Path):
        return Arrays(path / RESULTS)
    checkpoints = list(numbered(path, CHECKPOINTS).values())
    failures = Arrays(checkpoints[-1]).get("failures") if checkpoints else None
    return derive.derived(path, config, failures)


def _groups(path: AnyPath, folder: str, title: str, window: int | None) -> list[Group]:
    """Read the runs of a folder: one group for each task and cost."""
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
    """Return an error's text with `title` in place of the path, so that it names no machine."""
    return str(error).replace(str(path), title)


def _left_out(folder: str, missing: Mapping[int, str]) -> list[LeftOut]:
    """Return a note for each reason, naming the seeds that it applies to."""
    seeds: dict[str, list[int]] = {}
    for seed, why in missing.items():
        seeds.setdefault(why, []).append(seed)
    return [LeftOut(f"left out: {folder}, {_named(those)}: {why}") for why, those in seeds.items()]


def _named(seeds: Sequence[int]) -> str:
    return f"seed{'s' * (len(seeds) > 1)} {', '.join(map(str, seeds))}"


def run_records(arrays: Mapping[str, NDArray], run: RunId, cost: str) -> EpisodeRecords:
    """Return the records of a run's episodes so far. They are empty before the first checkpoint and
    if the first epoch failed. Raises UserError if they are damaged."""
    if f"{run.prefix}length" not in arrays:
        return CostRecorder(1).records
    try:
        return records_of(arrays, run.prefix, cost)
    except UserError:
        raise
    except UNREADABLE as error:
        raise UserError(f"is damaged: {error}") from None


def _read_run(training: Training, run: RunId, cost: str, window: int | None) -> RunResult:
    """Read a complete run. Raises UserError if the run is incomplete or damaged."""
    arrays, config = training.arrays, training.config
    if f"{run.prefix}failure" in arrays:
        raise UserError(str(arrays[f"{run.prefix}failure"]))
    if f"{run.prefix}length" not in arrays:
        raise UserError("has no recorded episodes")
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
    """Return means and values per episode for each evaluated policy."""
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
    """Count the episodes that end in each place, and in each place by the way to it."""
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
    """Merge groups that differ only in their seeds, and note each merge.

    Such groups stay separate if two of them share a seed: one of the two is a second training of
    the same run, which must not count twice.
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
        listed = (f"{g.title} ({_named(g.config.seeds)})" for g in same)
        notes.append(f"of equal settings, with other seeds, so counted as one: {'; '.join(listed)}")
    return pooled


def _settings(group: Group) -> tuple[Any, ...]:
    """Return the key by which groups are pooled: all settings but the seeds; 5 equals 5.0."""
    config = group.config
    training = (config.algorithm, config.steps, config.costs, config.task_parameters)
    return group.task, group.cost, *training, asdict(config.hyperparameters)
