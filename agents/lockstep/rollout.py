"""One episode of every run, collected in step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from agents.errors import UserError


class Rollout(NamedTuple):
    """Episodes side by side; steps at or beyond an episode's length hold nothing of it."""

    observation: NDArray[np.float32]
    """[T, N, observation size]"""
    action: NDArray[np.float32]
    """[T, N, action size], in [-1, 1]"""
    reward: NDArray[np.float64]
    """[T, N]"""
    cost: NDArray[np.float64]
    """[T, N]"""
    next_observation: NDArray[np.float32]
    """[T, N, observation size]"""
    terminated: NDArray[np.bool_]
    """[T, N]: the episode ended in a terminal state"""
    truncated: NDArray[np.bool_]
    """[T, N]: the episode was cut off, by a time limit for instance"""
    length: NDArray[np.int64]
    """[N]: steps of each episode"""

    @property
    def during(self) -> NDArray[np.bool_]:
        """Which steps belong to the episodes, [T, N]."""
        return np.arange(len(self.reward))[:, None] < self.length

    @property
    def returns(self) -> NDArray[np.float64]:
        """Undiscounted return of each episode, [N]."""
        return self._sums(self.reward)

    @property
    def cost_returns(self) -> NDArray[np.float64]:
        """Undiscounted cost return of each episode, [N]."""
        return self._sums(self.cost)

    def _sums(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Sums over each episode, [N], added in the order of time. `sum` would choose an order by
        the array's shape, and so by how long the other episodes are."""
        return np.cumsum(values, axis=0)[self.length - 1, np.arange(len(self.length))]

    @property
    def final_observation(self) -> NDArray[np.float32]:
        """What each episode ended with, [N, observation size]."""
        return self.next_observation[self.length - 1, np.arange(len(self.length))]


def require_cost(source: object, info: dict[str, Any]) -> None:
    """Raise UserError, naming the source, where the info of a step holds no cost."""
    if "cost" not in info:
        raise UserError(f"{source} gives no info['cost']; it gives {sorted(info) or 'nothing'}")


Act = Callable[[NDArray[np.float32]], NDArray[np.float32]]


def collect(envs: VectorEnv, seeds: Sequence[int], act: Act) -> Rollout:
    """One whole episode of every environment, each reset with its seed.

    envs: N environments that do not reset themselves (autoreset mode DISABLED); act: observations
    [N, observation size] -> actions [N, action size] in [-1, 1]. An environment whose episode has
    ended waits for the others; what it does meanwhile is left out. Raises UserError where the
    environment gives no `info["cost"]`.
    """
    observation, _ = envs.reset(seed=list(seeds))  # pyright: ignore[reportArgumentType]
    steps: list[tuple] = []
    length = np.zeros(len(seeds), dtype=np.int64)
    running = np.ones(len(seeds), dtype=bool)
    while running.any():
        action = act(observation)
        if not np.isfinite(action).all():
            raise UserError("training diverged: the policy's actions are not finite numbers")
        following, reward, terminated, truncated, info = envs.step(action)
        require_cost(envs, info)
        if not (np.isfinite(reward).all() and np.isfinite(info["cost"]).all()):
            raise UserError(f"{envs} gives a reward or cost that is not finite")
        if (np.asarray(info["cost"]) < 0).any():
            raise UserError(f"{envs} gives a negative cost")
        steps.append((observation, action, reward, info["cost"], following, terminated, truncated))
        length += running
        ended = terminated | truncated
        running &= ~ended
        observation = following
        if ended.any() and running.any():
            observation, _ = envs.reset(options={"reset_mask": ended.copy()})
    columns = [np.stack(column) for column in zip(*steps, strict=True)]
    return Rollout._make([*columns, length])
