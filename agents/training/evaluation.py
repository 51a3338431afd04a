"""Evaluation of a training's runs, all together, in whole episodes."""

from __future__ import annotations

import contextlib
from typing import NamedTuple

import numpy as np
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from agents.errors import TaskFailure, one_line
from agents.lockstep.noise import Purpose, environment_seeds, normal, steps_of_noise
from agents.lockstep.rollout import Policy as RunsPolicy
from agents.lockstep.rollout import Rollout, collect
from agents.training.config import TrainConfig
from agents.training.environments import is_native, looks_of, make_envs
from agents.training.wrappers import RecordSteps, SideBySide

SNAPSHOT_EPISODES = 20
"""Episodes of each run, per policy, in an evaluation during training."""
POLICIES = ("deterministic", "stochastic")
DRAWN = 5
"""Episodes of each trained policy that a report draws."""


class Episodes(NamedTuple):
    """Evaluated episodes of each run with one kind of policy; those of a void run mean nothing."""

    returns: NDArray[np.float64]
    """[R, N]: undiscounted"""
    costs: NDArray[np.float64]
    """[R, N, C]: undiscounted, of each cost"""
    lengths: NDArray[np.int64]
    """[R, N]: steps"""
    ends: NDArray[np.float32]
    """[R, N, 2]: positions at the ends of episodes; NaN if the task has no view"""
    failure: NDArray[np.object_]
    """[R]: `Rollout.failure` of the first episode that failed, or ''"""
    void: NDArray[np.bool_]
    """[R]: mask of the runs that were not evaluated, or failed in their evaluation"""
    paths: list[list[tuple[NDArray[np.float32], NDArray[np.float64]]]]
    """The first `DRAWN` episodes of each run, if its task has a view: positions [T + 1, 2], the
    start first, and costs [T]"""

    def why(self, k: int) -> str:
        """Return why the evaluation of the k-th run failed, in words."""
        cause = self.failure[k]
        if isinstance(cause, TaskFailure):
            return f"its evaluation failed: {one_line(cause)}"
        return f"its evaluation met a number that is not finite: its {cause}"

    def of_run(self, k: int) -> dict[str, NDArray]:
        """Return the numbers to keep of the k-th run's episodes, by name."""
        return {"returns": self.returns[k], "costs": self.costs[k], "lengths": self.lengths[k]}


def evaluate_runs(
    config: TrainConfig, policy: RunsPolicy, episodes: int, active: NDArray[np.bool_] | None = None
) -> dict[str, Episodes]:
    """Play episodes with the policy of every run, without and with its noise, by `POLICIES`.

    Start states and noise come from the run's seed, so that an evaluation can be repeated bit for
    bit. active: [R], runs to evaluate.
    """
    active = np.ones(len(config.runs), dtype=bool) if active is None else active
    # Limited by memory: an environment that is not native is a model or a process of its own. Noise
    # is drawn for all episodes in every part, so native ones have at most about 100 parts.
    native = config.vectorization == "auto" and all(map(is_native, config.tasks))
    at_once = min(episodes, max(100, episodes // 100) if native else 10)
    evaluated = {}
    with contextlib.closing(runs_envs(config, at_once)) as envs:
        for name in POLICIES:
            columns, paths, noisy = [], [], name == "stochastic"
            for first in range(0, episodes, at_once):
                rollout = play(envs, config, policy, episodes, first, at_once, active, noisy)
                paths = paths or paths_of(envs, rollout, len(active), DRAWN)
                values = (rollout.returns, rollout.cost_returns, rollout.length)
                values = (*values, ends_of(envs, rollout), rollout.failure)
                columns.append([v.reshape(len(active), at_once, *v.shape[1:]) for v in values])
            joined = (np.concatenate(parts, axis=1) for parts in zip(*columns, strict=True))
            returns, costs, lengths, ends, causes = (c[:, :episodes] for c in joined)
            failure = np.array([next(filter(None, of_run), "") for of_run in causes], dtype=object)
            failure[~active] = ""
            void = ~active | (failure != "")
            evaluated[name] = Episodes(returns, costs, lengths, ends, failure, void, paths)
    return evaluated


def runs_envs(config: TrainConfig, each: int) -> SideBySide:
    """Make the environments of all runs, `each` per run, which record their steps."""
    parts = []
    for task in config.tasks:
        envs = make_envs(
            task,
            len(config.seeds) * each,
            config.task_parameters,
            config.vectorization,
            config.step_timeout,
            config.task_costs,
            alone=True,
        )
        looks = looks_of(task, config.task_parameters)
        parts.append(RecordSteps(envs, looks.view, list(looks.recorded)))
    seen = [config.wrap(part, task) for part, task in zip(parts, config.tasks, strict=True)]
    return SideBySide(parts, config.costs, seen)


def play(
    envs: VectorEnv,
    config: TrainConfig,
    policy: RunsPolicy,
    episodes: int,
    first: int,
    count: int,
    active: NDArray[np.bool_],
    noisy: bool,
) -> Rollout:
    """Play `count` episodes per run, from number `first` on, of an evaluation of `episodes`.

    envs: R·count environments. The rollout holds run after run, [T, R·count].
    """
    runs, action_size = len(config.runs), (envs.single_action_space.shape or (1,))[0]
    chosen = np.arange(first, first + count) % episodes  # beyond the last: the caller drops them
    seeds = environment_seeds(config.stream_seeds, Purpose.EVALUATION, 0, episodes)
    seeds = np.array(seeds).reshape(runs, episodes)[:, chosen].ravel().tolist()
    shape = (episodes, action_size)
    noise = steps_of_noise(normal, config.stream_seeds, Purpose.EVALUATION, 1, shape)

    def act(observation: NDArray[np.float32]) -> NDArray[np.float32]:
        observation = observation.reshape(runs, count, -1)
        action = policy(observation, next(noise)[:, chosen] if noisy else None)
        return action.reshape(runs * count, -1)

    playing = np.repeat(active, count)
    return collect(envs, seeds, act, playing, config.costs, config.most_steps)


def ends_of(envs: SideBySide, rollout: Rollout) -> NDArray[np.float32]:
    """Return where each episode of a rollout ended, [N, 2]; NaN if its task has no view."""
    ends = np.full((envs.num_envs, 2), np.nan, dtype=np.float32)
    first = 0
    for part in envs.parts:
        own = slice(first, first := first + part.num_envs)
        if (located := part.with_start) is not None:
            ends[own] = located[rollout.length[own], np.arange(part.num_envs)]
    return ends


def paths_of(
    envs: SideBySide, rollout: Rollout, runs: int, most: int
) -> list[list[tuple[NDArray[np.float32], NDArray[np.float64]]]]:
    """Return `Episodes.paths` of a rollout, at most `most` of each run."""
    each = envs.num_envs // runs
    paths: list[list[tuple[NDArray[np.float32], NDArray[np.float64]]]] = []
    for part in envs.parts:
        located, before = part.with_start, len(paths) * each
        for start in range(0, part.num_envs, each):
            paths.append([])
            if located is None:
                continue
            for k in range(start, start + min(each, most)):
                steps, costs = rollout.length[before + k], rollout.cost[:, before + k, 0]
                paths[-1].append((located[: steps + 1, k], costs[:steps]))
    return paths
