"""`circle2d report`: tables, figures and the page of trained runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from agents import api
from agents.cli.options import Imports, parse
from agents.training.progress import working


@dataclass(frozen=True)
class ReportOptions:
    """Print the table of trained runs beside the paper's; write report.md, report.csv,
    and index.html with training curves and heat maps as well."""

    folder: Annotated[Path, tyro.conf.Positional]
    """Folder of runs, or one with several such folders below it."""
    imports: Imports = ()


def run(args: Sequence[str]) -> int:
    """Run `circle2d report`; returns the exit status."""
    folder = parse(ReportOptions, "report", args).folder
    with working("reading runs and drawing figures"):
        table = api.report(folder)
    print(table)
    return 0
