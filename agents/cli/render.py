"""`circle2d render`: draw episodes of trained policies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from agents.algorithms import title
from agents.cli.checks import check_size, check_suffix, one_for_each
from agents.cli.options import Folders, Imports, parse
from agents.errors import UserError
from agents.reporting import pictures
from agents.training.config import TrainConfig
from agents.training.pretrained import folder_of


@dataclass(frozen=True)
class RenderOptions:
    """Draw episodes of trained policies: all in one picture (.png), or as a film (.gif, .mp4).

    Several folders are drawn side by side, each with its name and what it has cost so far.
    """

    folders: Folders
    """Folders of runs on tasks that offer a view or, for films, frames of their own;
    pretrained:ALGORITHM/TASK is a policy that comes with the package."""
    out: Path | None = None
    """File to write, its suffix the format; by default trajectories.png in the first folder, or
    here for a policy of the package."""
    episodes: int = 3
    """The first episodes of the evaluation."""
    seed: tuple[int, ...] = ()
    """Of the run: one for all folders, or one for each; by default a folder's first."""
    names: tuple[str, ...] = ()
    """Titles above the panels, one for each folder; by default the algorithm and the seed."""
    stochastic: bool = False
    """Draw the stochastic policy instead of the deterministic one."""
    size: int = 640
    """Pixels along each side of a panel."""
    imports: Imports = ()


def run(args: Sequence[str]) -> int:
    """Run `circle2d render`; returns the exit status."""
    options = parse(RenderOptions, "render", args)
    folders, count = [folder_of(given) for given in options.folders], len(options.folders)
    if not count:
        raise UserError("render needs a folder of runs")
    names = one_for_each("names", options.names, count)
    seeds = one_for_each("seed", options.seed * (1 if options.seed[1:] else count), count)
    check_size(options.size)
    beside = folders[0] if folders[0] == options.folders[0] else Path()
    out = options.out or beside / "trajectories.png"
    check_suffix(out, ".png", ".gif", ".mp4")
    of_each = zip(folders, names, seeds, strict=True)
    panels = [_panel(options, *of_folder) for of_folder in of_each]
    if out.suffix.lower() == ".png":
        pictures.write_picture(out, pictures.picture(panels, options.size))
    else:
        total = pictures.pictures_of(panels)
        pictured = pictures.film(panels, options.size)
        if out.suffix.lower() == ".gif":
            pictured = pictures.few_colours(pictured)
        pictures.write_film(out, pictured, total)
    print(out)
    return 0


def _panel(
    options: RenderOptions, folder: Path, name: str | None, seed: int | None
) -> pictures.Panel:
    """The episodes of a folder's run, below its name or one that is given."""
    episodes, view = pictures.evaluation_episodes(
        folder, seed, options.episodes, options.stochastic
    )
    if name is None:
        config = TrainConfig.read(folder)
        name = f"{title(config.algorithm)}, seed {config.seeds[0] if seed is None else seed}"
    return pictures.Panel(name, view, episodes)
