"""`circle2d resume`: go on with interrupted runs."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from agents import api
from agents.cli import signals
from agents.cli.options import Imports, parse
from agents.cli.outcome import finish
from agents.errors import one_line
from agents.paper import grid
from agents.training.config import TrainConfig
from agents.training.machine import other_session


@dataclass(frozen=True)
class ResumeOptions:
    """Go on with interrupted runs from their last checkpoint; the results are bit for bit those of
    runs that were never interrupted."""

    folders: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER ...")]
    """Folder of the runs; several train together, if they differ only in task and seeds."""
    imports: Imports = ()


def run(args: Sequence[str]) -> int:
    """Run `circle2d resume`; returns the exit status."""
    options = parse(ResumeOptions, "resume", args)
    folders = options.folders
    configs = {folder: TrainConfig.read(folder) for folder in folders}
    for folder, config in configs.items():
        if (note := other_session(folder)) and not grid.finished(folder, config):
            print(f"circle2d: {one_line(folder)}: {note}", file=sys.stderr)
    with signals.AfterEpoch(options.imports) as after_epoch:
        runs = api.resume(*folders, progress=True, on_epoch=after_epoch)
    for folder in configs:
        if folder not in after_epoch.steps:  # no epoch was left to train
            note = "was done already: evaluated again"
            print(f"circle2d: {one_line(folder)}: {note}", file=sys.stderr)
    return finish(runs, after_epoch)
