"""The steps of a run folder: states visited in training, the replay's episodes, and episodes of
trained policies."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from agents.errors import UserError
from agents.lockstep.rollout import Rollout
from agents.training.config import TrainConfig, read_spaces, run_folder
from agents.training.environments import make_envs, view_of
from agents.training.evaluation import play
from agents.training.loop import EVALUATION_EPISODES
from agents.training.policy import load_learner
from agents.training.positions import RecordPositions
from agents.training.step_files import COSTS, VISITED, read_steps
from circle2d_mj.core.view import View
from circle2d_mj.render import canvas
from emcc import EpisodeRecords, emcc, worst
from emcc.parts import ALPHA, PARTS, rollouts_by_part

CELLS = 160
"""Along each side of a heat map."""
DRAWN = 5
"""Episodes of each trained policy that a report draws."""
DRAWN_POLICIES = 5
"""Runs of a folder, the first ones, whose trained policies a report draws."""
WINDOWS = 60
"""Of the replay, in equal parts of training."""
LAST = 65_535
"""Of the replay's grid."""


class Visits(NamedTuple):
    """States that the agents of some runs visited in a part of their training."""

    counts: NDArray[np.int64]
    """Visits of each cell, [CELLS, CELLS], the top row first."""
    emcc: float
    """Mean over the runs."""
    rollouts: int
    """Those that are counted."""
    of: int
    """All of the part."""


class Episode(NamedTuple):
    """One episode: where each step ended, and what it cost."""

    positions: NDArray[np.float32]
    """[T, 2] in the view's unit; [T + 1, 2], the start first, of a trained policy."""
    costs: NDArray[np.float64]
    """[T]"""


class ReplayEpisode(NamedTuple):
    """The episode of highest MCC in a window of training."""

    window: int
    """Of `WINDOWS`, from 0."""
    start_step: int
    """Environment steps before it."""
    points: NDArray[np.uint16]
    """Where each step ended, [T, 2]: see `Replay.positions`; [0, 2] where that was not recorded."""
    costs: NDArray[np.float64]
    """[T]"""


class Replay(NamedTuple):
    """Episodes of a run's training, one for each window, on a grid of 65 536 points a side."""

    episodes: list[ReplayEpisode]
    box: NDArray[np.float64]
    """The lowest and the highest of the points' coordinates in the view's unit, [2, 2]."""

    def positions(self, points: NDArray[np.uint16]) -> NDArray[np.float64]:
        """Points in the view's unit, [T, 2]."""
        return self.box[0] + points * ((self.box[1] - self.box[0]) / LAST)


def require_view(config: TrainConfig) -> View:
    """The view of the task. Raises UserError for one that has no positions."""
    view = view_of(config.task, config.task_parameters)
    if view is None:
        raise UserError(f"task {config.task!r} has no positions to draw: it offers no view")
    return view


def count_visits(
    folder: Path,
    config: TrainConfig,
    records: Sequence[EpisodeRecords],
    parts: Sequence[float] = tuple(PARTS),
    alpha: float = ALPHA,
    view: View | None = None,
) -> list[Visits]:
    """States of the rollouts that dominate EMCC in some parts of training, all runs together.

    records: those of each seed of the configuration. alpha: the share of rollouts with the highest
    MCC, those equal to the last of them included; 1 takes all. view: of the task, made here where
    it is not given. Source: the figures of visited states. Raises UserError where positions are
    missing or damaged.
    """
    extent = (view or require_view(config)).extent
    visited = [
        _visited(run_folder(folder, seed), of_run)
        for seed, of_run in zip(config.seeds, records, strict=True)
    ]
    found = []
    for part in parts:
        counts, values, chosen, of = np.zeros((CELLS, CELLS), np.int64), [], 0, 0
        for seed, of_run, positions in zip(config.seeds, records, visited, strict=True):
            rows, value, *rollouts = _dominating(of_run, config.steps, part, alpha)
            try:
                counts += canvas.count_visits(extent, positions[rows], CELLS)
            except ValueError as error:
                raise UserError(
                    f"{run_folder(folder, seed) / VISITED} is damaged: {error}"
                ) from None
            values.append(value)
            chosen, of = chosen + rollouts[0], of + rollouts[1]
        found.append(Visits(counts, float(np.mean(values)), chosen, of))
    return found


def _visited(folder: Path, records: EpisodeRecords) -> NDArray[np.float32]:
    visited, steps = read_steps(folder, VISITED), records.total_steps
    if len(visited) < steps:
        raise UserError(f"{folder} is damaged: {len(visited)} positions of {steps} steps")
    return visited[:steps]


def _dominating(
    records: EpisodeRecords, steps: int, part: float, alpha: float
) -> tuple[NDArray[np.bool_], float, int, int]:
    """Steps of a part's rollouts of highest MCC [steps]; EMCC; these rollouts, and all."""
    mcc, starts = records.mcc_per_rollout()
    in_part = np.flatnonzero(rollouts_by_part(starts, steps)[part])
    if not len(in_part):
        raise UserError(f"no rollout starts in part {part:g} of training")
    chosen = in_part[worst(mcc[in_part], alpha)]
    of_chosen = np.isin(records.rollout, np.unique(records.rollout)[chosen])
    rows = np.repeat(of_chosen, records.length)
    return rows, emcc(mcc[in_part], alpha), len(chosen), len(in_part)


def replay_rows(records: EpisodeRecords, steps: int) -> list[tuple[int, int]]:
    """For each window of training in which an episode starts: the window, and the row of the
    episode of highest MCC, the first of equal ones."""
    window = np.minimum(records.start_step * WINDOWS // steps, WINDOWS - 1)
    share = records.longest_streak / records.length
    # By window, then by falling MCC, then by time.
    order = np.lexsort((records.start_step, -share, window))
    windows, first = np.unique(window[order], return_index=True)
    return list(zip(windows.tolist(), order[first].tolist(), strict=True))


def read_costs(folder: Path, records: EpisodeRecords) -> NDArray[np.float64]:
    """Costs of all steps of a run, [steps]. Raises UserError where they are missing or damaged."""
    costs, steps = read_steps(folder, COSTS), records.total_steps
    if len(costs) < steps:
        raise UserError(f"{folder} is damaged: {len(costs)} costs of {steps} steps")
    return np.asarray(costs[:steps])


def replay(folder: Path, config: TrainConfig, records: EpisodeRecords) -> Replay:
    """The episode of highest MCC in each window of a run's training.

    folder: of the run. Raises UserError where the costs of steps are missing or damaged.
    """
    costs = read_costs(folder, records)
    try:
        visited = _visited(folder, records)
    except UserError:
        visited = np.empty((0, 2), np.float32)
    rows = replay_rows(records, config.steps)
    ends = [(int(records.start_step[row]), int(records.length[row])) for _, row in rows]
    paths = [np.array(visited[start : start + steps], np.float64) for start, steps in ends]
    everything = np.concatenate([*paths, np.zeros((int(not len(visited)), 2))])
    box = np.array([everything.min(axis=0), everything.max(axis=0)])
    size = np.where(box[1] > box[0], box[1] - box[0], 1.0)
    episodes = [
        ReplayEpisode(
            window,
            start,
            np.round((path - box[0]) / size * LAST).astype(np.uint16),
            costs[start : start + steps],
        )
        for (window, _), (start, steps), path in zip(rows, ends, paths, strict=True)
    ]
    return Replay(episodes, box)


def play_trained(
    folder: Path,
    config: TrainConfig,
    seeds: Sequence[int],
    episodes: int = DRAWN,
    noisy: bool = False,
    view: View | None = None,
) -> dict[int, list[Episode] | None]:
    """The first episodes of the evaluation of some runs, by seed; None of a policy that diverged.

    episodes: in [1, 100]; noisy: of the stochastic policy; view: as in `count_visits`. Raises
    UserError for a task without positions, or without a checkpoint.
    """
    view = view or require_view(config)
    made = make_envs(config.task, len(seeds) * episodes, config.task_parameters)
    with contextlib.closing(_FromStart(made, view)) as envs:
        rollout = play_first(envs, folder, config, seeds, episodes, noisy)
        start, then = envs.start, envs.positions
    played: list[Episode] = [
        Episode(
            np.concatenate((start[None, k], then[:steps, k])),
            rollout.cost[:steps, k].astype(np.float64),
        )
        for k, steps in enumerate(rollout.length)
    ]
    diverged = np.any(rollout.diverged.reshape(len(seeds), episodes), axis=1)
    return {
        seed: None if diverged[k] else played[k * episodes : (k + 1) * episodes]
        for k, seed in enumerate(seeds)
    }


def play_first(
    envs: VectorEnv,
    folder: Path,
    config: TrainConfig,
    seeds: Sequence[int],
    episodes: int,
    noisy: bool,
) -> Rollout:
    """The rollout of `play_trained`, run after run, in environments of the caller."""
    spaces = read_spaces(folder, config)
    policies = [load_learner(folder, config, spaces, seed)[0].policy() for seed in seeds]
    chosen, active = replace(config, seeds=tuple(seeds)), np.ones(len(seeds), dtype=bool)

    def act(observation: NDArray, noise: NDArray | None) -> NDArray:
        of_runs = range(len(policies))  # each alone, as it was evaluated
        at = [None if noise is None else noise[k : k + 1] for k in of_runs]
        return np.concatenate([policies[k](observation[k : k + 1], at[k]) for k in of_runs])

    return play(envs, chosen, act, EVALUATION_EPISODES, 0, episodes, active, noisy)


class _FromStart(RecordPositions):
    """Records where the agents start as well."""

    def __init__(self, env: VectorEnv, view: View) -> None:
        super().__init__(env, view)
        self._start: NDArray[np.float32] | None = None

    @property
    def start(self) -> NDArray[np.float32]:
        """Where they were reset, [num_envs, 2]; where the first step ended, for positions that are
        known of steps alone, such as velocities."""
        return self.positions[0] if self._start is None else self._start

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        observation, info = super().reset(seed=seed, options=options)
        if not self._positions:  # all were reset, not only those whose episode ended
            with contextlib.suppress(KeyError):
                found = self._view.positions(np.asarray(observation, dtype=np.float32), info)
                self._start = np.asarray(found, dtype=np.float32)
        return observation, info
