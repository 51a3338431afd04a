"""Runs as Python sees them after a training."""

from __future__ import annotations

import dataclasses
import os
import shutil
import weakref
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from agents.errors import UserError
from agents.reporting.report import table
from agents.reporting.table import markdown
from agents.results.archive import open_source
from agents.results.reading import Group, read_groups
from agents.results.source import FolderSource
from agents.training.config import NO_RUNS, TrainConfig, run_folder
from emcc import EpisodeRecords

if TYPE_CHECKING:
    import pandas

Rows = Literal["episodes", "runs"]


class Runs:
    """The runs of one folder or of several, and all that they left: see `load_runs`."""

    def __init__(self, folders: Sequence[Path], temporary: bool = False) -> None:
        """temporary: remove the folders with this object."""
        if isinstance(folders, (str, os.PathLike)):
            raise UserError(f"Runs takes a list of folders, got {folders!r}: see load_runs")
        self.folders = tuple(map(Path, folders))
        self.configs = tuple(TrainConfig.read(folder, strict=False) for folder in self.folders)
        """Of each folder."""
        if temporary:
            for folder in self.folders:
                weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)

    def __repr__(self) -> str:
        names = ", ".join(repr(str(folder)) for folder in self.folders)
        return f"Runs({names})"

    def __fspath__(self) -> str:
        """The folder, so that runs may stand where a folder does."""
        return str(self.folder)

    @property
    def folder(self) -> Path:
        """The folder. Raises ValueError where there are several: see `folders`."""
        if len(self.folders) != 1:
            raise ValueError(f"there are several folders, see `folders`: {self.folders}")
        return self.folders[0]

    @property
    def config(self) -> TrainConfig:
        """The configuration. Raises ValueError where there are several: see `configs`."""
        return self.configs[self.folders.index(self.folder)]

    @property
    def results(self) -> list[Group]:
        """Measures and records of the complete runs, for each folder.

        Folders are named from the parent that they have in common. Raises UserError where no run is
        complete: a run that was stopped has `records` only.
        """
        return [
            dataclasses.replace(group, folder=name)
            for folder, name in self._names.items()
            for group in read_groups(open_source(folder), [])
            if group.folder == "."  # not one whose folder lies within this one
        ]

    @property
    def records(self) -> dict[tuple[Path, int], EpisodeRecords]:
        """The episodes of every run so far, by folder and seed."""
        return {
            (folder, seed): EpisodeRecords.load(run_folder(folder, seed) / "episodes.csv")
            for folder, config in zip(self.folders, self.configs, strict=True)
            for seed in config.seeds
        }

    def table(self) -> str:
        """The table that the command prints, as Markdown; written into the folder too."""
        return "\n".join(markdown(table(folder)) for folder in self.folders)

    def to_pandas(self, rows: Rows = "episodes") -> pandas.DataFrame:
        """A row for each episode, as in `episodes.csv`, or for each complete run, of its measures.

        Its first columns are folder (as in `results`), algorithm, task, the hyper-parameters and
        task parameters in which the folders differ, and seed. Raises ImportError, saying how to
        install it, where pandas is missing.
        """
        if rows not in get_args(Rows):
            raise UserError(f"rows must be {' or '.join(get_args(Rows))}, got {rows!r}")
        try:
            import pandas as pd
        except ImportError:
            raise ImportError("to_pandas needs pandas: pip install pandas") from None
        if rows == "runs":
            found = [
                (group.folder, run.seed, {k: np.array([v], float) for k, v in run.measures.items()})
                for group in self.results
                for run in group.runs
            ]
        else:
            names = self._names
            found = [(names[of], seed, _columns(r)) for (of, seed), r in self.records.items()]
        about, frames = self._about(), []
        for folder, seed, columns in found:
            count = len(next(iter(columns.values())))
            first = {"folder": folder} | about[folder] | {"seed": seed}
            # Lists, since a hyper-parameter may be a tuple.
            frames.append(pd.DataFrame({k: [v] * count for k, v in first.items()} | columns))
        return pd.concat(frames, ignore_index=True)

    @property
    def _names(self) -> dict[Path, str]:
        """Each folder as seen from the parent that all have in common."""
        absolute = {folder: Path(os.path.abspath(folder)) for folder in self.folders}
        common = os.path.commonpath([folder.parent for folder in absolute.values()])
        return {folder: of.relative_to(common).as_posix() for folder, of in absolute.items()}

    def _about(self) -> dict[str, dict[str, Any]]:
        """Of each folder by its name: algorithm, task, and settings in which the folders differ."""
        settings = [dataclasses.asdict(c.hyperparameters) | c.task_parameters for c in self.configs]
        every = dict.fromkeys(setting for of in settings for setting in of)
        varied = [k for k in every if len({repr(of.get(k)) for of in settings}) > 1]
        return {
            name: {"algorithm": config.algorithm, "task": config.task}
            | {setting: of.get(setting) for setting in varied}
            for name, config, of in zip(self._names.values(), self.configs, settings, strict=True)
        }


def folders_of(*given: str | os.PathLike[str]) -> list[Path]:
    """Folders one by one; of runs all of theirs. Raises UserError for anything else."""
    found: list[Path] = []
    for of in given:
        if not isinstance(of, (str, os.PathLike)):
            raise UserError(f"give folders one by one, as in resume('a', 'b'), got {of!r}")
        found += of.folders if isinstance(of, Runs) else [Path(of)]
    return found


def load_runs(*folders: str | os.PathLike[str]) -> Runs:
    """Open the runs at or below folders, such as that of a sweep, finished or not. Changes nothing.

    An algorithm of one's own need not be registered. Raises UserError where there are no runs, and
    for a folder that is damaged.
    """
    found: dict[Path, None] = {}
    for root in folders_of(*folders):
        source = FolderSource(root)
        if source.problems or not source.configs:
            raise UserError("; ".join(source.problems) or f"{root} {NO_RUNS}")
        found |= dict.fromkeys(root / name for name in source.configs)
    if not found:
        raise UserError("load_runs needs a folder of runs")
    return Runs(list(found))


def _columns(records: EpisodeRecords) -> dict[str, Any]:
    """The columns of `episodes.csv` that there are."""
    values = {field.name: getattr(records, field.name) for field in dataclasses.fields(records)}
    names = {"reward": "return"}  # as in the file
    return {names.get(name, name): of for name, of in values.items() if of is not None}
