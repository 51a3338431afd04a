"""Evaluation of any policy on any task: episodes one after the other."""

from __future__ import annotations

import contextlib
import functools
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from agents.errors import TaskFailure, UserError
from agents.lockstep.rollout import MAX_STEPS
from agents.training.config import TrainConfig
from agents.training.environments import FloatCost, registered, task_id
from agents.training.policy import Policy, load_policy
from agents.training.pretrained import folder_of
from emcc import cvar, longest_streak


@dataclass(frozen=True, eq=False, repr=False)
class Evaluation:
    """Results of the episodes of an evaluation.

    The arrays are [episodes]; of a folder they are [runs, episodes], runs in the order of `seeds`.
    """

    task: str
    seeds: tuple[int, ...]
    """Of the runs of a folder, or of the policy's run; empty for any other policy."""
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
) -> Evaluation:
    """Play whole episodes with a policy, or with those of a folder of runs. Writes nothing.

    policy: what `load_policy` returned, a folder, runs, or any function of one observation to an
    action of the task. task: a gymnasium id with `info["cost"]`, by default the policy's own, with
    its `task_parameters`; required for a function. deterministic: for policies and folders;
    otherwise actions are drawn. seed: of the start states and draws, the same for all runs of a
    folder. Raises UserError where the task does not fit the policy.
    """
    if not isinstance(episodes, (int, np.integer)) or episodes < 1:
        raise UserError(f"episodes must be an integer of at least 1, got {episodes!r}")
    if task is not None:
        task = task_id(task)
    if isinstance(policy, (str, os.PathLike)):
        folder = folder_of(policy)
        seeds = TrainConfig.read(folder).seeds
        policies = [load_policy(folder, of_run) for of_run in seeds]
        task = task or policies[0].task
        if task_parameters is None and task == policies[0].task:
            task_parameters = policies[0].task_parameters
        found = [_play(p, task, episodes, deterministic, seed, task_parameters) for p in policies]
        columns = [np.array(column) for column in zip(*found, strict=True)]
        return Evaluation(task, seeds, *columns)
    seeds = ()
    if isinstance(policy, Policy):
        seeds = (policy.seed,)
        if task_parameters is None and task in (None, policy.task):
            task_parameters = policy.task_parameters
        task = task or policy.task
    elif not callable(policy):
        raise TypeError(f"policy must be a policy, a function or a folder, got {policy!r}")
    if task is None:
        raise UserError("evaluate needs the task where the policy is a function")
    columns = _play(policy, task, episodes, deterministic, seed, task_parameters)
    return Evaluation(task, seeds, *columns)


def _play(
    policy: Policy | Callable[[NDArray], Any],
    task: str,
    episodes: int,
    deterministic: bool,
    seed: int,
    parameters: dict[str, Any] | None,
) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Return, cost, length and longest streak of each episode."""
    name, rng = registered(task), np.random.default_rng([seed, 1])
    try:
        env = FloatCost(gym.make(name, disable_env_checker=True, **(parameters or {})))
    except Exception as error:  # of the task's own code
        raise UserError(f"cannot make task {task!r}: {error or type(error).__name__}") from None
    act: Callable[[NDArray], Any] = policy
    rows = []
    with contextlib.closing(env):
        if isinstance(policy, Policy):
            _check_fit(policy, env, task)
            act = functools.partial(policy, deterministic=deterministic, rng=rng)
        for start in np.random.default_rng(seed).integers(2**31, size=episodes).tolist():
            rewards, costs = _episode(env, act, start, task)
            rows.append((sum(rewards), sum(costs), len(costs), longest_streak(np.array(costs))))
    returns, costs, lengths, streaks = zip(*rows, strict=True)
    return np.array(returns), np.array(costs), np.array(lengths), np.array(streaks)


def _episode(
    env: gym.Env, act: Callable[[NDArray], Any], seed: int, task: str
) -> tuple[list[float], list[float]]:
    """Rewards and costs of an episode's steps."""
    with _failing(task, "in a reset"):
        observation, _ = env.reset(seed=seed)
    rewards, costs, over = [], [], False
    while not over:
        if len(costs) == MAX_STEPS:
            raise UserError(f"an episode of task {task!r} has not ended after {MAX_STEPS} steps")
        action = act(observation)
        _check_action(action, env.action_space)
        with _failing(task, f"in step {len(costs) + 1} of an episode"):
            observation, reward, terminated, truncated, info = env.step(action)
        rewards.append(float(reward))
        costs.append(info["cost"])
        over = terminated or truncated
    return rewards, costs


def _check_action(action: Any, space: gym.Space) -> None:
    """Raise UserError for an action that a policy must not give; bounds are the task's affair."""
    found = np.asarray(action)
    if found.dtype.kind not in "biuf" or not np.isfinite(found).all():
        raise UserError(f"the policy gives an action that is not finite: {action!r}")
    if isinstance(space, Box) and found.shape != space.shape:
        raise UserError(
            f"the policy gives an action of shape {list(found.shape)}, the task takes one of "
            f"{list(space.shape)}"
        )


@contextlib.contextmanager
def _failing(task: str, when: str) -> Iterator[None]:
    """Raise TaskFailure for any error of the task's own code."""
    try:
        yield
    except Exception as error:
        why = str(error) if isinstance(error, UserError) else f"{type(error).__name__}: {error}"
        raise TaskFailure(f"task {task!r} failed {when}: {why}") from None


def _check_fit(policy: Policy, env: gym.Env, task: str) -> None:
    """Raise UserError where a policy's observations or actions are not those of a task."""
    spaces, observation, action = policy.spaces, env.observation_space, env.action_space
    same = observation.shape == (spaces.observation_size,) and action.shape == (len(spaces.low),)
    of_task = f"actions {action}"
    if isinstance(action, gym.spaces.Box):
        of_task = f"actions from {action.low.tolist()} to {action.high.tolist()}"
        same = same and np.array_equal(action.low, np.array(spaces.low, action.dtype))
        same = same and np.array_equal(action.high, np.array(spaces.high, action.dtype))
    if not same:
        shape = list(observation.shape) if observation.shape is not None else observation
        raise UserError(
            f"the policy of {policy.task} takes observations [{spaces.observation_size}] and gives "
            f"actions from {list(spaces.low)} to {list(spaces.high)}; task {task!r} has "
            f"observations {shape} and {of_task}"
        )
