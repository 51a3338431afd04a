"""Runs on disk as Python objects."""

from __future__ import annotations

import os
import shutil
import warnings
import weakref
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

from agents.errors import OwnCodeError, UserError, extra
from agents.training.config import NO_RUNS, TrainConfig
from agents.training.files import opened
from emcc import EpisodeRecords

if TYPE_CHECKING:
    import pandas

    from agents.results.groups import Group, Training

Rows = Literal["measures", "episodes", "updates", "evaluations"]


class Runs:
    """The runs of one or several folders, and everything that they recorded: see `load_runs`."""

    def __init__(
        self,
        folders: Sequence[Path],
        temporary: bool = False,
        configs: Sequence[TrainConfig] | None = None,
        of: Sequence[Any] = (),
    ) -> None:
        """temporary: remove the folders with this object. configs: those of the folders, if the
        caller has them. of: other Runs of the folders, whose temporary ones stay as long as this
        object."""
        if isinstance(folders, (str, os.PathLike)):
            raise UserError(f"Runs takes a list of folders, got {folders!r}: see load_runs")
        self.folders = tuple(map(Path, folders))
        self._of = of
        read = configs or [TrainConfig.read(opened(f), strict=False) for f in self.folders]
        self.configs = tuple(read)
        """The configuration of each folder."""
        if temporary:
            for folder in self.folders:
                weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)

    def __repr__(self) -> str:
        names = ", ".join(repr(str(folder)) for folder in self.folders)
        return f"Runs({names})"

    def __fspath__(self) -> str:
        """Return the folder, so that runs can be passed where a folder is expected."""
        return str(self.folder)

    @property
    def folder(self) -> Path:
        """The folder. Raises UserError if there are several: see `folders`."""
        if len(self.folders) != 1:
            raise UserError(f"there are several folders, see `folders`: {self.folders}")
        return self.folders[0]

    @property
    def config(self) -> TrainConfig:
        """The configuration. Raises UserError if there are several: see `configs`."""
        return self.configs[self.folders.index(self.folder)]

    @property
    def results(self) -> list[Group]:
        """Measures and records of the complete runs, for each folder, task and cost.

        Folders are named by their paths below their common parent. A folder without a complete run
        is left out with a warning: a run that was stopped has only `records`. Raises UserError if
        no run is complete.
        """
        from agents.results.reading import read_folder

        groups: list[Group] = []
        left_out: list[UserError] = []
        for path, name in self._names.items():
            try:
                groups += read_folder(path, name)
            except OwnCodeError:
                raise
            except UserError as error:
                left_out.append(error)
        if left_out and not groups:
            raise left_out[0]
        for error in left_out:
            warnings.warn(f"left out: {error}", stacklevel=2)
        return groups

    @property
    def records(self) -> dict[Any, EpisodeRecords]:
        """The episodes of every run so far, by (folder, seed), or by (folder, task, seed) for a
        folder with several tasks."""
        return self.records_of()

    def records_of(self, cost: str | None = None) -> dict[Any, EpisodeRecords]:
        """Return the episodes of every run so far, with the given cost, by default the first; keys
        as in `records`."""
        from agents.results.reading import run_records

        records = {}
        for folder, training in zip(self.folders, self._trainings, strict=True):
            tasks, costs = training.config.tasks, training.config.costs
            for run in training.config.runs:
                if cost not in (None, *costs):
                    raise UserError(f"{folder} has no cost {cost!r}: {', '.join(costs)}")
                key = (folder, run.seed) if len(tasks) == 1 else (folder, *run)
                records[key] = run_records(training.arrays, run, cost or costs[0])
        return records

    def table(self) -> str:
        """Return the table that the command prints, as Markdown; also write it into the folder."""
        from agents.reporting.report import table
        from agents.reporting.table import markdown
        from agents.studies import used_study

        return "\n".join(markdown(table(folder, used_study())) for folder in self.folders)

    def to_pandas(self, rows: Rows = "measures") -> pandas.DataFrame:
        """Return the tidy frame from which reports are made: a row for each measure of each run.

        Its columns: source, group (a number for each folder, task and cost), name (in tables),
        task, algorithm, settings, cost, limit, folder, seed, steps, ends_in, measure, part (end of
        the third of training, NaN for the whole), window, value, and failure (why a run is
        incomplete; such a run has no values): see `agents.results.frame.frame`.

        rows: "episodes" and "updates" give a row for each episode, or each epoch's update, of every
        run so far, "evaluations" a row for each evaluated episode during training (step: the
        multiple of `evaluate_every` that was reached) and at the end. These frames have the columns
        folder, algorithm, task and seed, and the hyper-parameters and task parameters in which the
        folders differ. Archives hold only the multipliers of updates, at most 500 of each run, and
        the last evaluation.
        """
        if rows not in get_args(Rows):
            raise UserError(f"rows must be {', '.join(get_args(Rows))}, got {rows!r}")
        extra("pandas", "train")
        from agents.results import frame

        return (
            frame.frame(self.results)
            if rows == "measures"
            else frame.long_frame(self._trainings, rows)
        )

    @property
    def _trainings(self) -> list[Training]:
        """Each folder with its current content."""
        from agents.results.groups import Training
        from agents.results.reading import results_of

        trainings = []
        for (folder, name), config in zip(self._names.items(), self.configs, strict=True):
            path = opened(folder)
            trainings.append(Training(path, name, name, results_of(path, config), config))
        return trainings

    @property
    def _names(self) -> dict[Path, str]:
        """Each folder's path below the common parent."""
        absolute = {folder: Path(os.path.abspath(folder)) for folder in self.folders}
        common = os.path.commonpath([folder.parent for folder in absolute.values()])
        return {folder: path.relative_to(common).as_posix() for folder, path in absolute.items()}


def folders_of(*given: str | os.PathLike[str]) -> list[Path]:
    """Return the given folders, and those of given runs. Raises UserError for anything else."""
    folders: list[Path] = []
    for one in given:
        if not isinstance(one, (str, os.PathLike)):
            raise UserError(f"give folders one by one, as in resume('a', 'b'), got {one!r}")
        folders += one.folders if isinstance(one, Runs) else [Path(one)]
    return folders


def load_runs(*folders: str | os.PathLike[str]) -> Runs:
    """Open the runs at or below folders, finished or not, or in archives of `report`.

    Changes nothing. A folder may be that of a sweep. An algorithm of one's own need not be
    registered. Raises UserError if there are no runs, or a folder is damaged.
    """
    from agents.results.reading import folders_below

    paths: dict[Path, Path] = {}
    for root in folders_of(*folders):
        if not (names := folders_below(root)):
            raise UserError(f"{root} {NO_RUNS}")
        for path in (root / name for name in names):
            paths.setdefault(path.resolve(), path)
    if not paths:
        raise UserError("load_runs needs a folder of runs")
    return Runs([*paths.values()], of=folders)
