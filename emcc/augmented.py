"""Wrappers that append numbers computed from the episode's costs so far to the observation."""

from abc import ABC, abstractmethod
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from emcc.arrays import as_flag, check_range
from emcc.recorder import cost_of, costs_of
from emcc.wrappers import VectorSteps, five, of_kind, resets_itself

Numbers = NDArray[Any]
Bounds = tuple[tuple[float, float], ...]


class Augmentation(ABC):
    """A state computed from an episode's costs so far, for N environments at a time."""

    cost: str = "cost"
    """Key of the cost in info."""
    strict: ClassVar[bool] = True
    """Whether a negative or non-finite cost is an error."""
    start: tuple[float, ...]
    """The state of an environment before an episode's first step."""

    @property
    @abstractmethod
    def bounds(self) -> Bounds:
        """Low and high of each number that is appended to observations; () if none is."""

    @abstractmethod
    def after(self, state: Numbers, cost: Numbers) -> tuple[Numbers, dict[str, Numbers]]:
        """Return the states [N, size] after a step with costs [N], and the entries that are added
        to the step's info, [N] each."""

    @abstractmethod
    def shown(self, state: Numbers) -> Numbers:
        """Return the numbers [..., numbers] that observations show of the states [..., size]."""

    def behind(self, observation: Any, state: Numbers) -> Any:
        """Append what `shown` makes of the states [..., size] to the observations [..., n]."""
        if not self.bounds:
            return observation
        shown = np.asarray(self.shown(state), observation.dtype)
        return np.concatenate((observation, shown), axis=-1)

    def space(self, space: gym.Space) -> gym.Space:
        """Return the space of the augmented observations. TypeError: no flat Box of floats."""
        if not self.bounds:
            return space
        floats = np.issubdtype(space.dtype, np.floating)  # most appended numbers are fractions
        if not isinstance(space, Box) or len(space.shape) != 1 or not floats:
            raise TypeError(f"observe needs a flat Box of floats as observation space, got {space}")
        lows, highs = zip(*self.bounds, strict=True)
        low, high = np.append(space.low, lows), np.append(space.high, highs)
        return Box(low.astype(space.dtype), high.astype(space.dtype), dtype=space.dtype)  # pyright: ignore[reportArgumentType]


def augmented(env: gym.Env | VectorEnv, augmentation: Augmentation) -> Any:
    """Wrap an Env or a VectorEnv. TypeError: not a Gymnasium environment."""
    return of_kind(env, AugmentedEnv, AugmentedVectorEnv)(env, augmentation)


class AugmentedEnv(gym.Wrapper):
    """An Env whose observations and info show the state of an `Augmentation`."""

    def __init__(self, env: gym.Env, augmentation: Augmentation) -> None:
        super().__init__(env)
        self._of, self._finished = augmentation, False
        self._fresh = self._state = np.array([augmentation.start])
        self.observation_space = augmentation.space(env.observation_space)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset the environment and the state."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._state, self._finished = self._fresh, False
        return self._of.behind(observation, self._state[0]), info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step the environment."""
        resets = self._finished and resets_itself(self.env)
        values = five(self.env, self.env.step(action))
        observation, reward, terminated, truncated, info = values
        cost = np.array([0.0 if resets else cost_of(info, self._of.cost)])
        if self._of.strict:
            check_range(cost, self._of.cost, low=0)
        terminated, truncated = as_flag(terminated, "terminated"), as_flag(truncated, "truncated")
        self._finished = terminated or truncated
        after, told = self._of.after(self._fresh if resets else self._state, cost)
        self._state = self._fresh if resets else after
        info = {**info, **{name: values[0] for name, values in told.items()}}
        observation = self._of.behind(observation, self._state[0])
        return observation, reward, terminated, truncated, info


class AugmentedVectorEnv(VectorSteps):
    """A VectorEnv whose observations and info show the state of an `Augmentation`. The entries in
    info and in info["final_info"] are arrays [num_envs] that describe the step just taken, like the
    rewards, in every autoreset mode."""

    def __init__(self, env: VectorEnv, augmentation: Augmentation) -> None:
        super().__init__(env)
        self._of, self._fresh = augmentation, np.array([augmentation.start])
        self._state = np.repeat(self._fresh, env.num_envs, axis=0)
        self.single_observation_space = augmentation.space(env.single_observation_space)
        self.observation_space = batch_space(self.single_observation_space, env.num_envs)

    def _after_reset(self, where: NDArray[np.bool_], *result: Any) -> Any:
        observations, infos = result
        self._state = np.where(where[:, None], self._fresh, self._state)
        return self._of.behind(observations, self._state), infos

    def _after_step(self, active: NDArray[np.bool_], done: NDArray[np.bool_], *result: Any) -> Any:
        observations, rewards, terminated, truncated, infos = result
        cost = np.zeros(self.num_envs)
        if active.any():
            cost = costs_of(infos, active, done, self._of.cost)
        if self._of.strict:
            check_range(cost, f"{self._of.cost} of the environments", low=0)
        after, told = self._of.after(self._state, cost)
        state = np.where(active[:, None], after, self._fresh)
        infos = {**infos, **_with_masks(told, active)}
        if self._mode == AutoresetMode.SAME_STEP.value:
            if done.any():  # final_obs ends the old episodes; `observations` begins the next ones
                last = infos["final_obs"].copy()
                for index in np.flatnonzero(done):
                    last[index] = self._of.behind(last[index], state[index])
                final = {**infos.get("final_info", {}), **_with_masks(told, done)}
                infos |= {"final_info": final, "final_obs": last}
            state = np.where(done[:, None], self._fresh, state)
        self._state = state
        observations = self._of.behind(observations, state)
        return observations, rewards, terminated, truncated, infos


def _with_masks(told: dict[str, Numbers], where: NDArray[np.bool_]) -> dict[str, Any]:
    masked = {name: np.where(where, values, 0) for name, values in told.items()}
    return masked | {f"_{name}": where.copy() for name in told}
