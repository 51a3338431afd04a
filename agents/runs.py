"""Runs as Python sees them after a training."""

from __future__ import annotations

import dataclasses
import shutil
import weakref
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from agents.reporting.report import table
from agents.reporting.table import markdown
from agents.results.archive import open_source
from agents.results.reading import Group, read_groups
from agents.training.config import TrainConfig, run_folder
from emcc import EpisodeRecords

if TYPE_CHECKING:
    import pandas


class Runs:
    """The runs of one folder, or of several that trained jointly, and all that they left."""

    def __init__(self, folders: Sequence[Path], temporary: bool = False) -> None:
        """temporary: remove the folders with this object."""
        self.folders = tuple(folders)
        self.configs = tuple(TrainConfig.read(folder) for folder in folders)
        """Of each folder."""
        if temporary:
            for folder in self.folders:
                weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)

    def __repr__(self) -> str:
        names = ", ".join(repr(str(folder)) for folder in self.folders)
        return f"Runs({names})"

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

        Raises UserError where no run is complete: a run that was stopped has `records` only.
        """
        return [group for folder in self.folders for group in read_groups(open_source(folder), [])]

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

    def to_pandas(self) -> pandas.DataFrame:
        """A row for each episode of each run: algorithm, task, seed, then `episodes.csv`.

        Raises ImportError, saying how to install it, where pandas is missing.
        """
        try:
            import pandas as pd
        except ImportError:
            raise ImportError("to_pandas needs pandas: pip install pandas") from None
        configs = dict(zip(self.folders, self.configs, strict=True))
        frames = []
        for (folder, seed), records in self.records.items():
            config = configs[folder]
            names = {"reward": "return"}  # as in the file
            columns = {names.get(f.name, f.name): f.name for f in dataclasses.fields(records)}
            values = {name: getattr(records, of) for name, of in columns.items()}
            about = {"algorithm": config.algorithm, "task": config.task, "seed": seed}
            frame = pd.DataFrame({name: v for name, v in values.items() if v is not None})
            frames.append(frame.assign(**about)[[*about, *frame.columns]])
        return pd.concat(frames, ignore_index=True)
