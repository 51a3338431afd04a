"""The six-value interface of Safety-Gymnasium, for code that was written for it."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
from gymnasium.vector import VectorEnv, VectorWrapper


def SafetyGymnasiumAPI(env: gym.Env | VectorEnv) -> gym.Wrapper | VectorWrapper:
    """Wrap an environment so that `step` returns the cost as a value of its own.

    `step(action) -> observation, reward, cost, terminated, truncated, info`; `cost` is
    `info["cost"]`, a float or, for a vector environment, an array [num_envs]. Any single or vector
    environment with `info["cost"]` will do. TypeError for anything else, KeyError where a step
    gives no cost.
    """
    if isinstance(env, VectorEnv):
        return _SixValueVector(env)
    if isinstance(env, gym.Env):
        return _SixValue(env)
    raise TypeError(f"env must be a gymnasium Env or VectorEnv, got {env!r}")


class _SixValue(gym.Wrapper):
    def step(self, action: Any) -> tuple[Any, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        return _with_cost(self.env.step(action))


class _SixValueVector(VectorWrapper):
    def step(self, actions: Any) -> tuple[Any, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        return _with_cost(self.env.step(actions))


def _with_cost(result: tuple[Any, ...]) -> tuple[Any, ...]:
    observation, reward, terminated, truncated, info = result
    if "cost" not in info:
        raise KeyError(f"info has no 'cost'; its keys are {sorted(info)}")
    return observation, reward, info["cost"], terminated, truncated, info
