"""End of a training on the command line: tables on stdout, failures on stderr, exit status."""

from __future__ import annotations

import sys

from agents.cli.signals import AfterEpoch
from agents.errors import UserError, one_line
from agents.reporting.report import table
from agents.reporting.table import show
from agents.runs import Runs
from agents.training.config import FAILURE, run_folder
from agents.training.files import read_json


def finish(runs: Runs, after_epoch: AfterEpoch) -> int:
    """Print the table of every folder, and the failures; returns the exit status.

    after_epoch: says whether a signal stopped the training, of which one line is printed then.
    """
    if after_epoch.number is not None:
        print(f"circle2d: {one_line(after_epoch.words())}", file=sys.stderr)
        return 128 + after_epoch.number
    for folder in runs.folders:
        try:
            show(table(folder))
        except UserError as error:  # the training itself is done
            print(f"circle2d: no table: {one_line(error)}", file=sys.stderr)
    return name_failures(runs)


def name_failures(runs: Runs) -> int:
    """Name the runs that failed in training or evaluation; returns the exit status."""
    status = 0
    for folder, config in zip(runs.folders, runs.configs, strict=True):
        for seed in config.seeds:
            of_run = run_folder(folder, seed)
            if (of_run / FAILURE).exists():
                step = read_json(of_run / FAILURE).get("step")
                failure = f"seed {seed} failed at step {step}: it met a NaN or an infinite number"
            elif not (of_run / "evaluation.json").exists():
                failure = f"the evaluation of seed {seed} met a NaN or an infinite number"
            else:
                continue
            print(f"circle2d: {one_line(folder)}: {one_line(failure)}", file=sys.stderr)
            status = 1
    return status
