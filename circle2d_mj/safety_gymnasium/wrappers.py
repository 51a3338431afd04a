"""Wrappers with safety-gymnasium's names, for single or vector environments with six values."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import VectorEnv, VectorWrapper
from gymnasium.wrappers.utils import RunningMeanStd
from numpy.typing import NDArray

from circle2d_mj.safety.six_values import SafetyGymnasiumAPI

__all__ = [
    "Gymnasium2SafetyGymnasium",
    "SafeAutoResetWrapper",
    "SafeNormalizeCost",
    "SafeNormalizeObservation",
    "SafeNormalizeReward",
    "SafePassiveEnvChecker",
    "SafeRescaleAction",
    "SafeTimeLimit",
    "SafeUnsqueeze",
    "SafetyGymnasium2Gymnasium",
    "with_gymnasium_wrappers",
]
Six = tuple[Any, Any, Any, Any, Any, dict[str, Any]]

Gymnasium2SafetyGymnasium = SafetyGymnasiumAPI


class _Wrapper(gym.Wrapper):
    """A wrapper of single or vector environments; other attributes are the inner environment's."""

    env: Any

    def __init__(self, env: Any) -> None:
        self.is_vector_env = hasattr(env, "single_action_space")
        if self.is_vector_env:  # since Gymnasium 1.0, gym.Wrapper only accepts single environments
            self.env, self._cached_spec = env, None
            self._action_space = self._observation_space = self._metadata = None
        else:
            super().__init__(env)
        self.num_envs: int = getattr(env, "num_envs", 1)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name == "env":
            raise AttributeError(name)
        return getattr(self.env, name)


class SafetyGymnasium2Gymnasium(_Wrapper):
    """Wraps an environment with six values to return Gymnasium's five; the cost is `info["cost"]`.

    Around a `gymnasium.vector.VectorEnv`, the wrapper is a `gymnasium.vector.VectorWrapper`.
    """

    def __new__(cls, env: Any = None) -> Any:
        """Make the wrapper for a vector environment or for any other environment."""
        return _FiveValueVectorEnv(env) if isinstance(env, VectorEnv) else super().__new__(cls)

    def reset(self, **arguments: Any) -> tuple[Any, dict[str, Any]]:
        """Start a new episode; the info has a cost of 0."""
        observation, info = self.env.reset(**arguments)
        return observation, {**info, "cost": np.float64(0.0)}

    def step(self, action: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Return observation, reward, terminated, truncated, info."""
        return _five(self.env.step(action))


class _FiveValueVectorEnv(VectorWrapper):
    """`SafetyGymnasium2Gymnasium` of a VectorEnv; other attributes are the inner environment's."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name == "env":
            raise AttributeError(name)
        return getattr(self.env, name)

    def step(self, actions: Any) -> Any:
        """Return observations, rewards, terminated, truncated, infos."""
        return _five(self.env.step(actions))


def _five(values: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
    observation, reward, cost, terminated, truncated, info = values
    return observation, reward, terminated, truncated, {**info, "cost": cost}


def with_gymnasium_wrappers(env: Any, *wrappers: Callable[[Any], Any]) -> Any:
    """Wrap an environment with six values in Gymnasium's wrappers, the first one innermost."""
    for wrapper in (SafetyGymnasium2Gymnasium, *wrappers, Gymnasium2SafetyGymnasium):
        env = wrapper(env)
    return env


class SafePassiveEnvChecker(_Wrapper):
    """Raises AssertionError if an observation is outside its space or a cost is not finite."""

    def reset(self, **arguments: Any) -> tuple[Any, dict[str, Any]]:
        """Start a new episode."""
        return self._checked(self.env.reset(**arguments))

    def step(self, action: Any) -> Any:
        """Return observation, reward, cost, terminated, truncated, info."""
        values = self._checked(self.env.step(action))
        assert np.isfinite(values[2]).all(), f"the cost must be finite, got {values[2]!r}"
        return values

    def _checked(self, values: Any) -> Any:
        space = self.env.observation_space
        assert space.contains(values[0]), f"the observation {values[0]!r} is not in {space}"
        return values


class SafeAutoResetWrapper(_Wrapper):
    """Resets at once when an episode ends: the observation is the next episode's first, and the
    info has `final_observation` and `final_info`."""

    def step(self, action: Any) -> Six:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Return observation, reward, cost, terminated, truncated, info."""
        observation, reward, cost, terminated, truncated, info = self.env.step(action)
        if terminated or truncated:
            final = {"final_observation": observation, "final_info": info}
            observation, info = self.env.reset()
            info = {**info, **final}
        return observation, reward, cost, terminated, truncated, info


class SafeRescaleAction(_Wrapper):
    """Rescales actions from [min_action, max_action] to the bounds of the action space."""

    def __init__(self, env: Any, min_action: Any, max_action: Any) -> None:
        super().__init__(env)
        shape = env.action_space.shape
        self.min_action = np.full(shape, min_action, dtype=np.float64)
        self.max_action = np.full(shape, max_action, dtype=np.float64)
        self.action_space = gym.spaces.Box(self.min_action, self.max_action, dtype=np.float64)
        if self.is_vector_env:
            one = self.min_action[0], self.max_action[0]
            self.single_action_space = gym.spaces.Box(*one, dtype=np.float64)

    def step(self, action: Any) -> Six:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Return observation, reward, cost, terminated, truncated, info."""
        low, high = self.env.action_space.low, self.env.action_space.high
        share = (np.asarray(action) - self.min_action) / (self.max_action - self.min_action)
        return self.env.step(low + (high - low) * share)


class SafeTimeLimit(_Wrapper):
    """Truncates episodes after max_episode_steps."""

    def __init__(self, env: Any, max_episode_steps: int) -> None:
        super().__init__(env)
        self._limit, self._steps = max_episode_steps, 0

    def reset(self, **arguments: Any) -> tuple[Any, dict[str, Any]]:
        """Start a new episode."""
        self._steps = 0
        return self.env.reset(**arguments)

    def step(self, action: Any) -> Six:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Return observation, reward, cost, terminated, truncated, info."""
        *values, truncated, info = self.env.step(action)
        self._steps += 1
        return *values, truncated or self._steps >= self._limit, info  # pyright: ignore


class SafeNormalizeObservation(_Wrapper):
    """Normalises observations by their running mean and standard deviation, in `obs_rms`."""

    def __init__(self, env: Any, epsilon: float = 1e-8) -> None:
        super().__init__(env)
        space = env.single_observation_space if self.is_vector_env else env.observation_space
        self.obs_rms, self._epsilon = RunningMeanStd(shape=space.shape), epsilon

    def reset(self, **arguments: Any) -> tuple[Any, dict[str, Any]]:
        """Start a new episode."""
        observation, info = self.env.reset(**arguments)
        return self._normalized(observation), info

    def step(self, action: Any) -> Six:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Return observation, reward, cost, terminated, truncated, info."""
        observation, *values, info = self.env.step(action)
        if "final_observation" in info:
            raw = info["final_observation"]
            if self.is_vector_env:
                shown = [None if one is None else self._scaled(one) for one in raw]
                final = np.array([*shown, None], dtype=object)[:-1]
            else:
                final = self._scaled(raw)
            info = {**info, "original_final_observation": raw, "final_observation": final}
        return self._normalized(observation), *values, info  # pyright: ignore[reportReturnType]

    def _normalized(self, observation: Any) -> NDArray[np.float64]:
        self.obs_rms.update(observation if self.is_vector_env else np.array([observation]))
        return self._scaled(observation)

    def _scaled(self, observation: Any) -> NDArray[np.float64]:
        return (observation - self.obs_rms.mean) / np.sqrt(self.obs_rms.var + self._epsilon)


class _NormalizeReturn(_Wrapper):
    """Divides rewards or costs by the running standard deviation of their discounted sum, which
    starts again at a step that terminates."""

    _place: int

    def __init__(self, env: Any, gamma: float = 0.99, epsilon: float = 1e-8) -> None:
        super().__init__(env)
        self.return_rms, self._sum = RunningMeanStd(shape=()), np.zeros(self.num_envs)
        self._gamma, self._epsilon = gamma, epsilon

    def step(self, action: Any) -> Six:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Return observation, reward, cost, terminated, truncated, info."""
        values = list(self.env.step(action))
        went_on = np.logical_not(values[3])
        self._sum = self._sum * self._gamma * went_on + values[self._place]
        self.return_rms.update(self._sum)
        values[self._place] = values[self._place] / np.sqrt(self.return_rms.var + self._epsilon)
        return tuple(values)  # pyright: ignore[reportReturnType]


class SafeNormalizeReward(_NormalizeReturn):
    """Divides rewards by the running standard deviation of their discounted sum."""

    _place = 1


class SafeNormalizeCost(_NormalizeReturn):
    """Divides costs by the running standard deviation of their discounted sum."""

    _place = 2


class SafeUnsqueeze(_Wrapper):
    """Adds a leading axis of size 1 to everything that `step` and `reset` return, as in a vector
    environment; actions must have this axis, too."""

    def reset(self, **arguments: Any) -> tuple[Any, dict[str, Any]]:
        """Start a new episode."""
        observation, info = self.env.reset(**arguments)
        return np.expand_dims(observation, 0), self._unsqueezed(info)

    def step(self, action: Any) -> Six:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Return observation, reward, cost, terminated, truncated, info."""
        *values, info = self.env.step(np.asarray(action)[0])
        shown = (np.expand_dims(np.asarray(value), 0) for value in values)
        return *shown, self._unsqueezed(info)  # pyright: ignore[reportReturnType]

    def _unsqueezed(self, info: dict[str, Any]) -> dict[str, Any]:
        return {
            key: np.expand_dims(value, 0) if isinstance(value, np.ndarray) else value
            for key, value in info.items()
        }
