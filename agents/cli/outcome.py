"""End of a training on the command line: tables on stdout, failures on stderr, exit status."""

from __future__ import annotations

import sys
from pathlib import Path

from agents.errors import UserError
from agents.reporting.report import report
from agents.training.config import TrainConfig, run_folder
from agents.training.loop import Training, train
from agents.training.progress import show_progress


def train_folders(*folders: Path) -> int:
    """Train the runs of some folders together and print their tables; returns the exit status."""
    configs = {folder: TrainConfig.read(folder) for folder in folders}
    with show_progress(configs) as on_epoch:
        trainings = train(*configs, on_epoch=on_epoch)
    for folder in configs:
        try:
            print(report(folder))
        except UserError as error:  # the training itself is done
            print(f"circle2d: no table: {error}", file=sys.stderr)
    return max([name_failures(*pair) for pair in zip(configs, trainings, strict=True)])


def name_failures(folder: Path, training: Training) -> int:
    """Name the runs that failed in training or evaluation; returns the exit status."""
    lines = []
    for seed, failed, step in zip(
        training.config.seeds, training.failed, training.steps, strict=True
    ):
        if failed:
            lines.append(f"seed {seed} failed at step {step}: it met a number that is not finite")
        elif not (run_folder(folder, seed) / "evaluation.json").exists():
            lines.append(f"the evaluation of seed {seed} met a number that is not finite")
    for line in lines:
        print(f"circle2d: {folder}: {line}", file=sys.stderr)
    return int(bool(lines))
