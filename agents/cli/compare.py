"""`circle2d compare`: two sets of runs side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from agents.cli.checks import check_width
from agents.cli.options import Folder, Imports, parse
from agents.reporting.compare import compare
from agents.reporting.table import show
from agents.training.progress import working


@dataclass(frozen=True)
class CompareOptions:
    """Print the tables of two sets of runs, such as your algorithm's and a baseline's, with the
    differences B - A, their 95 % intervals over seeds, and permutation tests, on each task and over
    all tasks together."""

    a: Folder
    """Folder of runs, or one with several such folders below it, an archive, or a folder of an
    archive, such as results/circle2d/runs.zip/Circle2D-1-v0/sac-lb."""
    b: Folder
    """Folder of the runs to compare with them."""
    out: Path | None = None
    """Folder for compare.md, compare.csv, and compare.html with the training curves of both; by
    default nothing is written."""
    width: int | None = None
    """Characters of a line that tables fit; by default the terminal's. Into a file or a pipe they
    are printed as Markdown."""
    imports: Imports = ()


def run(args: Sequence[str]) -> int:
    """Run `circle2d compare`; returns the exit status."""
    options = parse(CompareOptions, "compare", args)
    check_width(options.width)
    with working("reading runs and drawing figures"):
        tables = compare(options.a, options.b, options.out)
    show(tables, options.width)
    return 0
