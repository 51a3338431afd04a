"""Where the agents went: heat maps of training, trajectories and films of trained policies."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.algorithms import algorithm
from agents.errors import UserError
from agents.training.config import FAILURE, TrainConfig, run_folder
from agents.training.environments import circle2d_config, make_envs
from agents.training.evaluation import play
from agents.training.loop import EVALUATION_EPISODES, load_training
from agents.training.step_files import VISITED, read_steps
from circle2d_mj import Circle2DConfig
from circle2d_mj.circle2d.task import position
from circle2d_mj.circle2d.view import Circle2DView
from circle2d_mj.core.view import Picture
from circle2d_mj.render import canvas
from circle2d_mj.render.figure import figure
from circle2d_mj.render.gl import NoOpenGL
from circle2d_mj.render.renderer import CELLS, SIZE, Renderer
from emcc import EpisodeRecords, emcc, worst
from emcc.parts import rollouts_by_part

ALPHA = 0.1
"""Of EMCC, as the paper chose it."""
PARTS = {
    0.33: "0 to 33 % of training",
    0.66: "33 to 66 % of training",
    0.99: "66 to 99 % of training",
}


class Visits(NamedTuple):
    """Where the agents of some runs were in a part of their training."""

    positions: NDArray[np.float32]
    """[N, 2], world units"""
    emcc: float
    """Mean over the runs"""
    rollouts: int
    """Those that the positions are of"""
    of: int
    """All of the part"""


def visits(folder: Path, config: TrainConfig, part: float, alpha: float) -> Visits:
    """The states of a part's rollouts that dominate its EMCC, of all runs of a configuration.

    part: one of `PARTS`. alpha: the share of rollouts with the highest MCC, those equal to the last
    of them included; 1 takes all. Source: the figures of visited states, which show the rollouts
    that contribute most to EMCC. Raises UserError where a run has no records or damaged ones.
    """
    found = [_visits(run_folder(folder, seed), config, part, alpha) for seed in config.seeds]
    return Visits(
        np.concatenate([of_run.positions for of_run in found]),
        float(np.mean([of_run.emcc for of_run in found])),
        sum(of_run.rollouts for of_run in found),
        sum(of_run.of for of_run in found),
    )


def _visits(folder: Path, config: TrainConfig, part: float, alpha: float) -> Visits:
    records, visited = _records(folder), read_steps(folder, VISITED)
    steps = int(records.length.sum())
    if len(visited) < steps:
        raise UserError(f"{folder} is damaged: {len(visited)} positions of {steps} steps")
    mcc, starts = records.mcc_per_rollout()
    in_part = np.flatnonzero(rollouts_by_part(starts, config.steps)[part])
    if not len(in_part):
        raise UserError(f"{folder}: no rollout starts in part {part:g} of its training")
    chosen = in_part[worst(mcc[in_part], alpha)]
    of_chosen = np.isin(records.rollout, np.unique(records.rollout)[chosen])
    rows = np.repeat(of_chosen, records.length.astype(np.intp))
    return Visits(visited[:steps][rows], emcc(mcc[in_part], alpha), len(chosen), len(in_part))


def _records(folder: Path) -> EpisodeRecords:
    try:
        return EpisodeRecords.load(folder / "episodes.csv")
    except FileNotFoundError:
        raise UserError(f"{folder} has no records yet: no checkpoint was reached") from None
    except (OSError, ValueError) as error:
        raise UserError(str(error)) from None


def heatmap(
    folder: Path,
    parts: Sequence[float],
    alpha: float,
    size: int = SIZE,
    seeds: tuple[int, ...] | None = None,
) -> Picture:
    """Heat maps of the parts of a training, side by side: [height, width, 3].

    folder: of runs of one algorithm, of which those of the seeds (by default all that have not
    failed) are taken together; parts and alpha: see `visits`; size: pixels along the side of each
    map. The title names the seeds where they are not all.
    """
    config, task = _circle2d_runs(folder)
    everyone, config = config.seeds, _of_seeds(folder, config, seeds)
    of_parts = [visits(folder, config, part, alpha) for part in parts]
    most = canvas.most_visits([counts(folder, task, of_part) for of_part in of_parts])
    with _renderer(task, size) as renderer:
        pictures = [renderer.heatmap(of_part.positions, most=most) for of_part in of_parts]
    title = f"{algorithm(config.algorithm).title} on {config.task}"
    if set(config.seeds) != set(everyone):
        title += f" (seeds: {', '.join(map(str, config.seeds))})"
    return figure(
        [pictures],
        [PARTS[part] for part in parts],
        title=title,
        captions=[[caption(of_part) for of_part in of_parts]],
        most_visits=most,
    )


def _of_seeds(folder: Path, config: TrainConfig, seeds: tuple[int, ...] | None) -> TrainConfig:
    if seeds is None:
        failed = [(run_folder(folder, seed) / FAILURE).exists() for seed in config.seeds]
        seeds = tuple(seed for seed, f in zip(config.seeds, failed, strict=True) if not f)
        if not seeds:
            raise UserError(f"no heat map: all runs of {folder} have failed")
    if not seeds or not set(seeds) <= set(config.seeds):
        raise UserError(f"seeds must be some of {list(config.seeds)}, got {list(seeds)}")
    return replace(config, seeds=seeds)


def counts(folder: Path, task: Circle2DConfig, found: Visits) -> NDArray[np.int64]:
    """How often each cell of a heat map was visited, [CELLS, CELLS]: see `canvas.count_visits`.

    folder: of the runs, for the UserError where positions are none of the task.
    """
    try:
        return canvas.count_visits(Circle2DView(task).extent, found.positions, CELLS)
    except ValueError as error:
        raise UserError(f"{folder}: the record of visited states is damaged: {error}") from None


def caption(found: Visits) -> str:
    """What stands below a heat map."""
    return f"EMCC {found.emcc:.2f} ({found.rollouts:,} of {found.of:,} rollouts)"


class Episodes(NamedTuple):
    """Episodes of a trained policy."""

    paths: list[NDArray[np.float64]]
    """[T + 1, 2] each, world units, the start first"""
    costs: list[NDArray[np.float64]]
    """[T] each"""


def trajectories(episodes: Episodes, task: Circle2DConfig, size: int = SIZE) -> Picture:
    """All episodes in one picture: [size, size, 3]."""
    with _renderer(task, size) as renderer:
        return renderer.trajectories(episodes.paths, episodes.costs)


def film(episodes: Episodes, task: Circle2DConfig, size: int = SIZE) -> Iterator[Picture]:
    """The episodes one after another, a picture for each state, with the way that led there."""
    with _renderer(task, size) as renderer:
        for path, costs in zip(episodes.paths, episodes.costs, strict=True):
            for k in range(len(path)):
                yield renderer.trajectories([path[: k + 1]], [costs[:k]], agent=path[k])


def evaluation_episodes(
    folder: Path, seed: int | None, episodes: int, noisy: bool
) -> tuple[Episodes, Circle2DConfig]:
    """The first episodes of the evaluation of one run, and their task.

    seed: of the run, the folder's first by default; noisy: of the stochastic policy. Raises
    UserError for a seed that the folder has not, or another task than Circle2D.
    """
    config, task = _circle2d_runs(folder)
    seed = config.seeds[0] if seed is None else seed
    if seed not in config.seeds:
        raise UserError(f"{folder} has no run of seed {seed}: its seeds are {list(config.seeds)}")
    if not 1 <= episodes <= EVALUATION_EPISODES:
        raise UserError(f"episodes must be in [1, {EVALUATION_EPISODES}], got {episodes}")
    found = episodes_by_seed(folder, episodes, noisy)[seed]
    if found is None:
        raise UserError(f"the policy of seed {seed} gives numbers that are not finite")
    return found, task


def episodes_by_seed(folder: Path, episodes: int, noisy: bool) -> dict[int, Episodes | None]:
    """The first episodes of the evaluation of every run of a folder, by seed.

    None where a policy gives numbers that are not finite. episodes: in [1, 100]; noisy: of the
    stochastic policy. Raises UserError for another task than Circle2D, or without a checkpoint.
    """
    config, task = _circle2d_runs(folder)
    runs = len(config.seeds)
    policy, everyone = load_training(folder).learner.policy(), np.ones(runs, dtype=bool)
    with contextlib.closing(make_envs(config.task, runs * episodes, config.task_parameters)) as e:
        rollout = play(e, config, policy, EVALUATION_EPISODES, 0, episodes, everyone, noisy)
    start, then = (
        position(task, observation)
        for observation in (rollout.observation, rollout.next_observation)
    )
    found: dict[int, Episodes | None] = {}
    for run, seed in enumerate(config.seeds):
        columns = range(run * episodes, (run + 1) * episodes)
        paths = [np.concatenate((start[:1, k], then[: rollout.length[k], k])) for k in columns]
        costs = [rollout.cost[: rollout.length[k], k] for k in columns]
        found[seed] = None if rollout.diverged[columns].any() else Episodes(paths, costs)
    return found


def _circle2d_runs(folder: Path) -> tuple[TrainConfig, Circle2DConfig]:
    config = TrainConfig.read(folder)
    task = circle2d_config(config.task, config.task_parameters)
    if task is None:
        raise UserError(f"pictures are of Circle2D tasks; {folder} holds runs on {config.task}")
    return config, task


def _renderer(task: Circle2DConfig, size: int) -> Renderer:
    """Raises UserError where nothing can draw here, or the task cannot be drawn."""
    try:
        return Renderer(task, size)
    except (NoOpenGL, ValueError) as error:
        raise UserError(f"no pictures: {error}") from None
