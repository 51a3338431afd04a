"""`circle2d render`: draw episodes of a trained policy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from agents.cli.options import Imports, check_size, check_suffix, parse
from agents.reporting import image_files, pictures


@dataclass(frozen=True)
class RenderOptions:
    """Draw episodes of a trained policy: all in one picture (.png), or as a film (.gif, .mp4)."""

    folder: Annotated[Path, tyro.conf.Positional]
    """Folder of runs on a task that offers positions."""
    out: Path | None = None
    """File to write, its suffix the format; by default trajectories.png in the folder."""
    episodes: int = 3
    """The first episodes of the evaluation."""
    seed: int | None = None
    """Of the run; by default the folder's first."""
    stochastic: bool = False
    """Draw the stochastic policy instead of the deterministic one."""
    size: int = 640
    """Pixels along each side."""
    imports: Imports = ()


def run(args: Sequence[str]) -> int:
    """Run `circle2d render`; returns the exit status."""
    options = parse(RenderOptions, "render", args)
    check_size(options.size)
    out = options.out or options.folder / "trajectories.png"
    check_suffix(out, ".png", ".gif", ".mp4")
    episodes, view = pictures.evaluation_episodes(
        options.folder, options.seed, options.episodes, options.stochastic
    )
    if out.suffix.lower() == ".png":
        image_files.write_picture(out, pictures.trajectories(episodes, view, options.size))
    else:
        total = sum(len(episode.positions) for episode in episodes)
        image_files.write_film(out, pictures.film(episodes, view, options.size), total)
    print(out)
    return 0
