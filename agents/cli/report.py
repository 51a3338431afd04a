"""`circle2d report`: tables, figures and the page of trained runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from agents.cli.checks import check_width
from agents.cli.options import Folders, Imports, parse
from agents.reporting.report import report
from agents.reporting.table import show
from agents.training.progress import working


@dataclass(frozen=True)
class ReportOptions:
    """Print the table of trained runs beside the paper's; write report.md, report.csv,
    and index.html with training curves and heat maps as well."""

    folders: Folders
    """Folders of runs, folders above such folders, archives, or folders in archives. All go into
    one report, such as your runs beside results/circle2d/runs.zip/Circle2D-1-v0."""
    archive: Path | None = None
    """Archive to write, with all that the report needs; `circle2d report FILE` makes the report
    from it."""
    out: Path | None = None
    """Folder for the report; by default the folder of the runs, or a folder beside the archive with
    its name. Required with several FOLDERs."""
    width: int | None = None
    """Characters of a line that tables fit; by default the terminal's. Into a file or a pipe they
    are printed as Markdown."""
    imports: Imports = ()


def run(args: Sequence[str]) -> int:
    """Run `circle2d report`; returns the exit status: 1 where runs had to be left out."""
    options = parse(ReportOptions, "report", args)
    check_width(options.width)
    with working("reading runs and drawing figures"):
        written = report(*options.folders, archive=options.archive, out=options.out)
    show(written.blocks, options.width)
    return int(bool(written.left_out))
