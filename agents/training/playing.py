"""Evaluation of any policy on any task: episodes one after the other."""

from __future__ import annotations

import contextlib
import functools
import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from agents.errors import OwnCodeError, TaskFailure, UserError, described
from agents.lockstep.rollout import MAX_STEPS
from agents.training.config import TrainConfig
from agents.training.environments import registered, task_id
from agents.training.policy import Policy, load_policy
from agents.training.pretrained import folder_of
from agents.training.wrappers import CheckedEnv
from emcc import cvar, longest_streak


@dataclass(frozen=True, eq=False, repr=False)
class Evaluation:
    """Results of the episodes of an evaluation.

    The arrays are [episodes]; of a folder they are [runs, episodes], runs in the order of its
    tasks and seeds.
    """

    task: str
    seeds: tuple[int, ...]
    """Seeds of the runs of a folder, or of the policy's run; empty for any other policy."""
    returns: NDArray[np.float64]
    """Undiscounted sum of the rewards of each episode."""
    costs: NDArray[np.float64]
    """Undiscounted sum of the costs."""
    lengths: NDArray[np.int64]
    """Steps."""
    longest_streaks: NDArray[np.int64]
    """Longest streak of consecutive steps with a cost, in steps."""

    def __repr__(self) -> str:
        runs = f"runs={len(self.returns)}, " if self.returns.ndim > 1 else ""
        return (
            f"Evaluation(task={self.task!r}, {runs}episodes={self.returns.shape[-1]}, "
            f"mean_return={self.mean_return:.2f}, mean_cost={self.mean_cost:.2f}, "
            f"mcc={self.mcc:.2f})"
        )

    @property
    def mean_return(self) -> float:
        """Mean of `returns`."""
        return float(self.returns.mean())

    @property
    def mean_cost(self) -> float:
        """Mean of `costs`."""
        return float(self.costs.mean())

    @property
    def mean_length(self) -> float:
        """Mean of `lengths`."""
        return float(self.lengths.mean())

    @property
    def mcc(self) -> float:
        """Maximum consecutive cost steps: the greatest share of an episode in one streak."""
        return float((self.longest_streaks / self.lengths).max())

    def cvar(self, alpha: float = 0.5) -> float:
        """Conditional value at risk of `costs`: see `emcc.cvar`."""
        return cvar(self.costs.ravel(), alpha)


def evaluate(
    policy: Policy | Callable[[NDArray], Any] | str | os.PathLike[str],
    task: str | None = None,
    episodes: int = 100,
    deterministic: bool = True,
    seed: int = 0,
    task_parameters: dict[str, Any] | None = None,
    cost: str = "cost",
) -> Evaluation:
    """Play whole episodes with a policy, or with those of a folder of runs. Writes nothing.

    policy: what `load_policy` returned, a folder, runs, or any function of one observation to an
    action of the task. task: a gymnasium id with `info["cost"]`, by default the policy's own, with
    its `task_parameters`; required for a function. deterministic: for policies and folders;
    otherwise actions are drawn. seed: of the start states and draws, the same for all runs of a
    folder. cost: its name in the infos. Raises UserError where the task does not fit the policy.
    """
    if not isinstance(episodes, (int, np.integer)) or isinstance(episodes, bool) or episodes < 1:
        raise UserError(f"episodes must be an integer of at least 1, got {episodes!r}")
    if isinstance(policy, (str, os.PathLike)):
        folder = folder_of(policy)
        config = TrainConfig.read(folder)
        policies = [load_policy(folder, run.seed, task=run.task) for run in config.runs]
        given = (task, episodes, deterministic, seed, task_parameters, cost)
        results = [evaluate(of_run, *given) for of_run in policies]
        names = ("returns", "costs", "lengths", "longest_streaks")
        columns = [np.array([getattr(result, name) for result in results]) for name in names]
        return Evaluation(results[0].task, config.seeds, *columns)
    if not callable(policy):
        raise TypeError(f"policy must be a policy, a function or a folder, got {policy!r}")
    own = policy if isinstance(policy, Policy) else None
    if task is None and own is None:
        raise UserError("evaluate needs the task where the policy is a function")
    name = task_id(task) if task is not None else own.task if own else ""
    if own and task_parameters is None and name == own.task:
        task_parameters = own.task_parameters
    try:
        made = gym.make(registered(name), disable_env_checker=True, **(task_parameters or {}))
    except Exception as error:  # of the task's own code
        raise OwnCodeError(f"cannot make task {name!r}: {described(error)}") from error
    with contextlib.closing(CheckedEnv(made, (cost,))) as env:
        act: Callable[[NDArray], Any] = policy
        if own:
            _check_fit(own, env.observation_space, env.action_space, name)
            rng = np.random.default_rng([seed, 1])
            act = functools.partial(own, deterministic=deterministic, rng=rng)
        starts = np.random.default_rng(seed).integers(2**31, size=episodes).tolist()
        try:
            played = [_episode(env, act, start, cost) for start in starts]
        except TaskFailure as error:
            raise TaskFailure(f"task {name!r} {error}") from error.__cause__
    return Evaluation(name, (own.seed,) if own else (), *map(np.array, zip(*played, strict=True)))


def _episode(
    env: gym.Env, act: Callable[[NDArray], Any], seed: int, cost: str
) -> tuple[float, float, int, int]:
    """Return, cost, length and longest streak of an episode."""
    observation, _ = env.reset(seed=seed)
    rewards, costs, over = [], [], False
    while not over:
        if len(costs) == MAX_STEPS:
            raise TaskFailure(f"has an episode that has not ended after {MAX_STEPS} steps")
        action = act(observation)
        _check_action(action, env.action_space)
        observation, reward, terminated, truncated, info = env.step(action)
        rewards.append(float(reward))
        costs.append(info[cost])
        over = terminated or truncated
    return sum(rewards), sum(costs), len(costs), longest_streak(np.array(costs))


def _check_action(action: Any, space: gym.Space) -> None:
    """Raise UserError for an action that a policy must not give; bounds are the task's affair."""
    given = np.asarray(action)
    if given.dtype.kind not in "biuf" or not np.isfinite(given).all():
        raise UserError(f"the policy gives an action that is not finite: {action!r}")
    if isinstance(space, Box) and given.shape != space.shape:
        raise UserError(
            f"the policy gives an action of shape {list(given.shape)}, the task takes one of "
            f"{list(space.shape or ())}"
        )


def _check_fit(policy: Policy, observation: gym.Space, action: gym.Space, task: str) -> None:
    """Raise UserError where a policy's observations or actions are not those of a task."""
    spaces = policy.spaces
    same = observation.shape == (spaces.observation_size,) and action.shape == (len(spaces.low),)
    if isinstance(action, Box):
        bounds = ((action.low, spaces.low), (action.high, spaces.high))
        same = same and all(np.array_equal(a, np.array(b, action.dtype)) for a, b in bounds)
    if not same or not isinstance(action, Box):
        raise UserError(
            f"the policy of {policy.task} takes observations [{spaces.observation_size}] and gives "
            f"actions from {list(spaces.low)} to {list(spaces.high)}; task {task!r} has "
            f"observations {observation} and actions {action}"
        )
