"""The commands that draw: heatmap, render, scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from agents.cli.options import parse
from agents.errors import UserError
from agents.reporting import image_files as files
from agents.reporting import pictures
from circle2d_mj import Circle2DConfig
from circle2d_mj.render.gl import NoOpenGL, check_backend
from emcc.parts import ALPHA, PARTS


@dataclass(frozen=True)
class HeatmapOptions:
    """Draw which states the agents visited in training, in the rollouts that dominate EMCC, of the
    runs of a folder together: a PNG."""

    folder: Annotated[Path, tyro.conf.Positional]
    """Folder of runs on a task that offers positions."""
    part: tuple[float, ...] = tuple(PARTS)
    """Parts of training, named as EMCC names them: 0.33, 0.66, 0.99."""
    alpha: float = ALPHA
    """Share of a part's rollouts, those of the highest MCC; 1 draws all."""
    seeds: tuple[int, ...] | None = None
    """Of the runs; by default all but those that failed."""
    out: Path | None = None
    """File to write; by default heatmap.png in the folder."""
    size: int = 640
    """Pixels along each side of a map."""


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


@dataclass(frozen=True)
class SceneOptions:
    """Print the MuJoCo scene of a task as MJCF, to be opened in MuJoCo's viewer."""

    config: Annotated[Circle2DConfig, tyro.conf.OmitArgPrefixes] = field(
        default_factory=Circle2DConfig
    )
    actuation: str = "velocity"
    """velocity: servos; force: motors against a damping."""


def run_heatmap(args: Sequence[str]) -> int:
    """`circle2d heatmap`; returns the exit status, as the others do."""
    options = parse(HeatmapOptions, "heatmap", args)
    if not options.part or not set(options.part) <= set(PARTS):
        raise UserError(f"part must be some of {list(PARTS)}, got {list(options.part)}")
    _check_size(options.size)
    if not 0 < options.alpha <= 1:
        raise UserError(f"alpha must be in (0, 1], got {options.alpha}")
    out = options.out or options.folder / "heatmap.png"
    _check_suffix(out, ".png")
    of_file = (options.part, options.alpha, options.size, options.seeds)
    picture = pictures.heatmap(options.folder, *of_file)
    files.write_picture(out, picture)
    print(out)
    return 0


def run_render(args: Sequence[str]) -> int:
    """`circle2d render`."""
    options = parse(RenderOptions, "render", args)
    _check_size(options.size)
    out = options.out or options.folder / "trajectories.png"
    _check_suffix(out, ".png", ".gif", ".mp4")
    episodes, view = pictures.evaluation_episodes(
        options.folder, options.seed, options.episodes, options.stochastic
    )
    if out.suffix.lower() == ".png":
        files.write_picture(out, pictures.trajectories(episodes, view, options.size))
    else:
        total = sum(len(episode.positions) for episode in episodes)
        files.write_film(out, pictures.film(episodes, view, options.size), total)
    print(out)
    return 0


def run_scene(args: Sequence[str]) -> int:
    """`circle2d scene`."""
    options = parse(SceneOptions, "scene", args)
    try:
        check_backend()
        from circle2d_mj.circle2d.scene import scene

        spec = scene(options.config, options.actuation)
    except (ValueError, NoOpenGL) as error:
        raise UserError(str(error)) from None
    spec.compile()
    print(spec.to_xml(), end="")
    return 0


def _check_suffix(path: Path, *allowed: str) -> None:
    if path.suffix.lower() not in allowed:
        raise UserError(f"out must end in {' or '.join(allowed)}, got {str(path)!r}")


def _check_size(size: int) -> None:
    if not 64 <= size <= 4096 or size % 2:
        raise UserError(f"size must be an even number in [64, 4096], got {size}")
