"""Pictures of runs on demand: heat maps of training, episodes of trained policies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from agents.errors import UserError
from agents.paper.settings import title_of
from agents.reporting.figures import Ground, visits_words
from agents.results.frames import Filmed, film_trained
from agents.results.steps import Episode, Visits, count_visits, play_trained, require_view
from agents.training.config import FAILURE, TrainConfig, run_folder
from agents.training.environments import view_of
from agents.training.loop import EVALUATION_EPISODES
from circle2d_mj.core.view import Picture, View
from circle2d_mj.render import canvas
from circle2d_mj.render.figure import figure
from emcc import EpisodeRecords
from emcc.parts import PARTS

SIZE = 640


def heatmap(
    folders: Sequence[Path],
    parts: Sequence[float],
    alpha: float,
    size: int = SIZE,
    seeds: tuple[int, ...] | None = None,
    names: Sequence[str | None] | None = None,
) -> Picture:
    """Heat maps of parts of training: [height, width, 3].

    folders: each of runs of one algorithm, of which those of the seeds (by default all that have
    not failed) are taken together. The parts of a single folder stand side by side; several folders
    are the columns, the parts the rows, with one scale for all. parts and alpha: see
    `steps.count_visits`; size: pixels along the side of each map. names: titles of the folders; by
    default the algorithm, its settings and the task, and the seeds where they are not all. Raises
    UserError for a folder without positions, or of another seed.
    """
    names = names or [None] * len(folders)
    columns = [
        _maps_of(folder, parts, alpha, seeds, name)
        for folder, name in zip(folders, names, strict=True)
    ]
    most = canvas.most_visits([part.counts for column in columns for part in column.parts])
    grounds = [Ground(column.view, column.view.background(size)) for column in columns]
    pictures = [
        [ground.heatmap(part, most) for part in column.parts]
        for column, ground in zip(columns, grounds, strict=True)
    ]
    captions = [[visits_words(part) for part in column.parts] for column in columns]
    thirds, titles = [f"{PARTS[part]} of training" for part in parts], [of.title for of in columns]
    if len(columns) == 1:
        return figure(pictures, thirds, title=titles[0], captions=captions, most_visits=most)
    return figure(
        list(zip(*pictures, strict=True)),
        titles,
        row_titles=thirds,
        captions=list(zip(*captions, strict=True)),
        most_visits=most,
    )


class _MapsOf(NamedTuple):
    """A folder's title, view, and visits in each part."""

    title: str
    view: View
    parts: list[Visits]


def _maps_of(
    folder: Path,
    parts: Sequence[float],
    alpha: float,
    seeds: tuple[int, ...] | None,
    name: str | None,
) -> _MapsOf:
    config = TrainConfig.read(folder)
    view = require_view(config)
    everyone, config = config.seeds, _of_seeds(folder, config, seeds)
    records = [_records(run_folder(folder, seed)) for seed in config.seeds]
    heading = name or f"{title_of(config)} on {config.task}"
    if name is None and set(config.seeds) != set(everyone):
        heading += f" (seeds: {', '.join(map(str, config.seeds))})"
    return _MapsOf(heading, view, count_visits(folder, config, records, parts, alpha, view))


def _records(folder: Path) -> EpisodeRecords:
    try:
        return EpisodeRecords.load(folder / "episodes.csv")
    except FileNotFoundError:
        raise UserError(f"{folder} has no records yet: no checkpoint was reached") from None
    except (OSError, ValueError) as error:
        raise UserError(str(error)) from None


def _of_seeds(folder: Path, config: TrainConfig, seeds: tuple[int, ...] | None) -> TrainConfig:
    if seeds is None:
        failed = [(run_folder(folder, seed) / FAILURE).exists() for seed in config.seeds]
        seeds = tuple(seed for seed, f in zip(config.seeds, failed, strict=True) if not f)
        if not seeds:
            raise UserError(f"no heat map: all runs of {folder} have failed")
    if not seeds or not set(seeds) <= set(config.seeds):
        raise UserError(f"seeds must be some of {list(config.seeds)}, got {list(seeds)}")
    return replace(config, seeds=seeds)


def evaluation_episodes(
    folder: Path, seed: int | None, episodes: int, noisy: bool
) -> tuple[list[Episode] | list[Filmed], View | None]:
    """The first episodes of the evaluation of one run, and the view of their task.

    Without a view the episodes are the task's own frames. seed: of the run, the folder's first by
    default; noisy: of the stochastic policy. Raises UserError for a seed that the folder has not,
    or a task without view and frames.
    """
    config = TrainConfig.read(folder)
    seed = config.seeds[0] if seed is None else seed
    if seed not in config.seeds:
        raise UserError(f"{folder} has no run of seed {seed}: its seeds are {list(config.seeds)}")
    if not 1 <= episodes <= EVALUATION_EPISODES:
        raise UserError(f"episodes must be in [1, {EVALUATION_EPISODES}], got {episodes}")
    view = view_of(config.task, config.task_parameters)
    if view is None:
        found = film_trained(folder, config, seed, episodes, noisy)
    else:
        found = play_trained(folder, config, [seed], episodes, noisy, view)[seed]
    if found is None:
        raise UserError(f"the policy of seed {seed} gives numbers that are not finite")
    return found, view
