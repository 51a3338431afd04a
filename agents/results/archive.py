"""Archives: one file with all that a report needs, without the run folders.

A zip file of `index.json` and .npy arrays; nothing in it is unpickled. Left out is what follows
from the rest: the costs of steps, where they were recorded, give each episode's cost, longest
streak, cost steps and streaks. Returns of training's episodes are kept to five digits
(`precision.five_digits`); all else is exact, but for the replay's positions (`steps.Replay`).
"""

from __future__ import annotations

import io
import json
import lzma
import struct
import zipfile
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.errors import UserError
from agents.results import columns
from agents.results.reading import Group
from agents.results.source import DamagedSource, FolderSource, RunFiles, Source, title
from agents.results.steps import DRAWN_POLICIES, Episode, Replay, ReplayEpisode, Visits, replay_rows
from agents.training.config import TrainConfig
from agents.training.files import write_whole
from emcc import EpisodeRecords

FORMAT, VERSION = "circle2d results", 1
INDEX = "index.json"
UNREADABLE = (
    *(OSError, ValueError, KeyError, TypeError, EOFError, RuntimeError),
    *(zipfile.BadZipFile, lzma.LZMAError, struct.error),
)
"""Errors of files that are no zip files, or damaged ones."""
FIRST = (1980, 1, 1, 0, 0, 0)
"""Date of every member: equal results give equal bytes."""


def open_source(path: Path) -> Source:
    """The runs in a folder, in an archive, or in a folder of an archive, such as
    `runs.zip/Circle2D-1-v0`. Raises UserError for anything else."""
    archive = archive_of(path)
    if archive is None:
        return FolderSource(path)
    return ArchiveSource(archive, path.relative_to(archive).as_posix())


def archive_of(path: Path) -> Path | None:
    """The file that a path is or leads into; None for a path of folders alone."""
    return next((of for of in (path, *path.parents) if of.is_file()), None)


def write_archive(path: Path, source: Source, groups: Sequence[Group]) -> None:
    """Write the runs of a source into an archive, whole or not at all.

    groups: all that were read from the source.
    """
    by_folder = {group.folder: group for group in groups}
    content: dict[str, Any] = {"format": FORMAT, "version": VERSION, "name": source.name}
    content["problems"] = list(source.problems)
    content["folders"] = []
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_LZMA) as file:
        for number, (folder, config) in enumerate(source.configs.items()):
            entry = {"folder": folder, "config": config, "sessions": source.sessions(folder)}
            if folder in by_folder:
                arrays = _pack_group(source, by_folder[folder], entry)
                for name, array in arrays.items():
                    _add(file, f"{number}/{name}.npy", _npy(array))
            content["folders"].append(entry)
        _add(file, INDEX, json.dumps(content).encode())
    write_whole(path, buffer.getvalue())


def _add(file: zipfile.ZipFile, name: str, data: bytes) -> None:
    file.writestr(zipfile.ZipInfo(name, FIRST), data, zipfile.ZIP_LZMA)


def _npy(array: NDArray) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=False)
    return buffer.getvalue()


def _pack_group(source: Source, group: Group, entry: dict[str, Any]) -> dict[str, NDArray]:
    """The arrays of a folder's runs, by name; all else goes into its entry of the index."""
    folder, config = group.folder, group.config
    entry["missing"] = {str(seed): why for seed, why in group.missing.items()}
    entry["runs"], entry["lacking"], entry["diverged"] = {}, {}, []
    arrays = {}
    if group.runs:
        records = {run.seed: run.records for run in group.runs}
        try:
            visits = source.visits(folder, config, records)
            arrays["visits"] = np.array([part.counts for part in visits], dtype=np.uint32)
            entry["visits"] = [[part.emcc, part.rollouts, part.of] for part in visits]
        except UserError as error:
            entry["lacking"]["visits"] = str(error)
        try:
            trained = source.trained(folder, config, group.seeds[:DRAWN_POLICIES])
        except UserError as error:
            trained, entry["lacking"]["trained"] = {}, str(error)
        entry["diverged"] = [seed for seed, played in trained.items() if played is None]
        for seed, played in trained.items():
            arrays |= {f"{seed}/trained_{k}": v for k, v in _pack_episodes(played or []).items()}
    for run in group.runs:
        evaluation = source.run(folder, config, run.seed).evaluation
        of_run: dict[str, Any] = {"evaluation": evaluation, "ends": run.ends, "ways": run.ways}
        packed: dict[str, NDArray] = {}
        try:
            costs = source.costs(folder, run.seed, run.records)
            replay = source.replay(folder, config, run.seed, run.records)
            packed |= columns.pack_costs(costs)
            packed["replay"] = np.concatenate([e.points for e in replay.episodes])
            of_run["replay_box"] = replay.box.tolist()
        except UserError as error:
            costs, of_run["no_costs"] = None, str(error)
        packed |= columns.pack_records(run.records, costs)
        arrays |= {f"{run.seed}/{name}": array for name, array in packed.items()}
        entry["runs"][str(run.seed)] = of_run
    return arrays


def _beside(part: PurePosixPath, folders: Collection[PurePosixPath]) -> str:
    """The folders of an archive where a part of it was looked for, in words."""
    inside = [of for of in part.parents if any(folder.is_relative_to(of) for folder in folders)]
    parent = inside[0] if inside else PurePosixPath()
    below = [of.relative_to(parent).parts for of in folders if of.is_relative_to(parent)]
    name = "it" if parent == PurePosixPath() else parent
    return f"{name} has {', '.join(sorted({of[0] for of in below if of})) or 'none'}"


def _pack_episodes(episodes: Sequence[Episode]) -> dict[str, NDArray]:
    return {
        "length": np.array([len(episode.costs) for episode in episodes], dtype=np.int64),
        "positions": np.concatenate([e.positions for e in episodes] or [np.empty((0, 2), "f4")]),
        "costs": np.concatenate([e.costs for e in episodes] or [np.empty(0)]),
    }


class ArchiveSource:
    """Runs in an archive. Raises UserError for a file that is none, or a damaged one."""

    def __init__(self, path: Path, part: str = ".") -> None:
        """part: folder of the archive with the runs at or below it; by default all."""
        self.path, within = path, PurePosixPath(part)
        self.name: str
        self.problems: Sequence[str]
        self.configs: Mapping[str, dict[str, Any]]
        try:
            self._file = zipfile.ZipFile(path)
            content = json.loads(self._file.read(INDEX))
            form, version = content["format"], content["version"]
        except UNREADABLE:
            raise UserError(
                f"{path} is no archive that circle2d report wrote, or a damaged one"
            ) from None
        if form != FORMAT or version != VERSION:
            raise UserError(
                f"{path} is an archive of form {form!r}, version {version!r}; this program reads "
                f"{FORMAT!r}, version {VERSION}"
            )
        try:
            self.name = within.name or content["name"]
            self.problems = content["problems"]
            every = {PurePosixPath(of["folder"]): of for of in content["folders"]}
            found = {
                folder.relative_to(within).as_posix(): (number, entry)
                for number, (folder, entry) in enumerate(every.items())
                if folder.is_relative_to(within)
            }
            self._numbers = {folder: number for folder, (number, _) in found.items()}
            self._entries = {folder: entry for folder, (_, entry) in found.items()}
            self.configs = {folder: entry["config"] for folder, entry in self._entries.items()}
        except (KeyError, TypeError) as error:
            raise self._damaged(error) from None
        if within.name and not found:
            raise UserError(f"{path} has no folder {part}; {_beside(within, every)}")

    def title(self, folder: str) -> str:
        """A folder as seen from beside the one that was archived."""
        return title(self.name, folder)

    def sessions(self, folder: str) -> Mapping[str, float]:
        """Seconds that each process trained a folder; empty where nothing says."""
        return self._entry(folder, "sessions")

    def run(self, folder: str, config: TrainConfig, seed: int) -> RunFiles:
        """Read a run. Raises UserError where it failed, or was missing or damaged."""
        missing = self._entry(folder, "missing")
        if str(seed) in missing:
            raise UserError(missing[str(seed)])
        of_run = self._of_run(folder, seed)
        costs = None if "no_costs" in of_run else self._all_costs(folder, seed)
        try:
            records = columns.unpack_records(self._arrays(folder, seed), costs)
            ways = of_run.get("ways", {})  # earlier archives have none
            return RunFiles(records, of_run["evaluation"], of_run["ends"], ways)
        except (KeyError, ValueError, TypeError, IndexError) as error:
            raise self._damaged(error) from None

    def costs(self, folder: str, seed: int, records: EpisodeRecords) -> NDArray[np.float64]:
        """Costs of all steps of a run, [steps]. Raises UserError."""
        of_run = self._of_run(folder, seed)
        if "no_costs" in of_run:
            raise UserError(of_run["no_costs"])
        return self._all_costs(folder, seed)[: records.total_steps]

    def visits(
        self, folder: str, config: TrainConfig, records: Mapping[int, EpisodeRecords]
    ) -> list[Visits]:
        """States visited in each third of training, of all runs. Raises UserError."""
        self._require(folder, "visits")
        counts, others = self._array(folder, "visits"), self._entry(folder, "visits")
        pairs = zip(counts.astype(np.int64), others, strict=True)
        return [Visits(of_part, *numbers) for of_part, numbers in pairs]

    def trained(
        self, folder: str, config: TrainConfig, seeds: Sequence[int]
    ) -> dict[int, list[Episode] | None]:
        """Episodes of the trained policies, by seed; None of one that diverged. UserError."""
        self._require(folder, "trained")
        diverged = self._entry(folder, "diverged")
        return {k: None if k in diverged else self._episodes(folder, k) for k in seeds}

    def _episodes(self, folder: str, seed: int) -> list[Episode]:
        names = ("length", "positions", "costs")
        length, positions, costs = (self._array(folder, f"{seed}/trained_{k}") for k in names)
        ends = np.cumsum(length)[:-1]
        paths = np.split(positions, ends + np.arange(1, len(length)))
        return [Episode(*pair) for pair in zip(paths, np.split(costs, ends), strict=True)]

    def replay(
        self, folder: str, config: TrainConfig, seed: int, records: EpisodeRecords
    ) -> Replay:
        """The episode of highest MCC in each window of training. Raises UserError."""
        costs, points = self.costs(folder, seed, records), self._array(folder, f"{seed}/replay")
        episodes, at = [], 0
        for window, row in replay_rows(records, config.steps):
            start, length = int(records.start_step[row]), int(records.length[row])
            path = points[at : at + length]
            at += len(path)
            episodes.append(ReplayEpisode(window, start, path, costs[start : start + length]))
        return Replay(episodes, np.array(self._of_run(folder, seed)["replay_box"]))

    def _all_costs(self, folder: str, seed: int) -> NDArray[np.float64]:
        try:
            return columns.unpack_costs(self._arrays(folder, seed))
        except (KeyError, ValueError, TypeError) as error:
            raise self._damaged(error) from None

    def _entry(self, folder: str, name: str) -> Any:
        try:
            return self._entries[folder][name]
        except KeyError as error:
            raise self._damaged(error) from None

    def _of_run(self, folder: str, seed: int) -> dict[str, Any]:
        try:
            return self._entry(folder, "runs")[str(seed)]
        except (KeyError, TypeError) as error:
            raise self._damaged(error) from None

    def _require(self, folder: str, name: str) -> None:
        lacking = self._entry(folder, "lacking")
        if name in lacking:
            raise UserError(lacking[name])

    def _arrays(self, folder: str, seed: int) -> columns.Arrays:
        """The arrays of a run by name, each read when it is asked for."""
        there = self._file.NameToInfo
        prefix = f"{self._numbers[folder]}/{seed}"
        return columns.Arrays(
            lambda name: f"{prefix}/{name}.npy" in there,
            lambda name: self._array(folder, f"{seed}/{name}"),
        )

    def _array(self, folder: str, name: str) -> NDArray:
        try:
            data = self._file.read(f"{self._numbers[folder]}/{name}.npy")
            return np.load(io.BytesIO(data), allow_pickle=False)
        except UNREADABLE as error:
            raise self._damaged(error) from None

    def _damaged(self, error: Exception) -> DamagedSource:
        return DamagedSource(f"{self.path} is damaged: {error}")
