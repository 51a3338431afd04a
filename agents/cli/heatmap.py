"""`circle2d heatmap`: draw which states were visited in training."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from agents.cli.checks import check_size, check_suffix, one_for_each
from agents.cli.options import Folders, Imports, parse
from agents.errors import UserError
from agents.reporting import pictures
from emcc.parts import ALPHA, PARTS


@dataclass(frozen=True)
class HeatmapOptions:
    """Draw which states the agents visited in training, in the rollouts that dominate EMCC, of the
    runs of a folder together: a PNG. Several folders are drawn beside each other."""

    folders: Folders
    """Folders of runs on tasks that offer positions."""
    part: tuple[float, ...] = tuple(PARTS)
    """Parts of training, named as EMCC names them: 0.33, 0.66, 0.99."""
    alpha: float = ALPHA
    """Share of a part's rollouts, those of the highest MCC; 1 draws all."""
    seeds: tuple[int, ...] | None = None
    """Of the runs; by default all but those that failed."""
    names: tuple[str, ...] = ()
    """Titles, one for each folder; by default the algorithm with its settings, and the task."""
    out: Path | None = None
    """File to write; by default heatmap.png in the first folder."""
    size: int = 640
    """Pixels along each side of a map."""
    imports: Imports = ()


def run(args: Sequence[str]) -> int:
    """Run `circle2d heatmap`; returns the exit status."""
    options = parse(HeatmapOptions, "heatmap", args)
    if not options.folders:
        raise UserError("heatmap needs a folder of runs")
    if not options.part or not set(options.part) <= set(PARTS):
        raise UserError(f"part must be some of {list(PARTS)}, got {list(options.part)}")
    check_size(options.size)
    if not 0 < options.alpha <= 1:
        raise UserError(f"alpha must be in (0, 1], got {options.alpha}")
    out = options.out or options.folders[0] / "heatmap.png"
    check_suffix(out, ".png")
    names = one_for_each("names", options.names, len(options.folders))
    of_file = (options.part, options.alpha, options.size, options.seeds, names)
    picture = pictures.heatmap(options.folders, *of_file)
    pictures.write_picture(out, picture)
    print(out)
    return 0
