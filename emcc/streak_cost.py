"""StreakCost for gymnasium: a cost that grows along streaks, for any environment and algorithm."""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Box
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from emcc.arrays import as_flag, as_number, check_range
from emcc.recorder import cost_of, costs_of
from emcc.streaks import weighted
from emcc.wrappers import VectorSteps, five, of_kind, resets_itself


def StreakCost(
    env: gym.Env | VectorEnv,
    weight: float = 1.0,
    *,
    observe: bool = True,
    scale: float = 10.0,
    threshold: float = 0.0,
) -> "StreakCostEnv | StreakCostVectorEnv":
    """Wrap an Env or VectorEnv so that long streaks of cost steps cost more than short ones.

    info["cost"] becomes the cost times `1 + weight (k - 1)` at the k-th consecutive cost step, so
    that an algorithm that limits cost limits streaks as well; info["plain_cost"] is the cost as it
    was. What an agent is judged by is the plain cost: `RecordCosts` and `EMCCCallback` record it,
    inside or outside of this wrapper.
    observe: append k / scale, which is 0 after a safe step, to the observation, so that the task
    stays Markov: without it the cost depends on what the agent cannot see. The observation space
    must then be a flat Box. scale: cost steps that make the observation 1.
    threshold: a step whose cost exceeds it is a cost step.
    In a vector environment info["cost"] and info["plain_cost"] are [num_envs] arrays of the step
    just taken, in every autoreset mode, as rewards are; so are those in info["final_info"].
    TypeError: no gymnasium environment, or no flat Box of floats to append to. ValueError: weight
    below 0, scale not above 0, a bad threshold, a vector environment without an autoreset mode, a
    cost that is negative or not finite. KeyError: a step without a cost. RuntimeError: a step after
    an episode's end without a reset.
    """
    weight, threshold = as_number(weight, "weight", 0), as_number(threshold, "threshold", 0)
    if as_number(scale, "scale") <= 0:
        raise ValueError(f"scale must be above 0, got {scale}")
    kind = of_kind(env, StreakCostEnv, StreakCostVectorEnv)
    return kind(env, weight, float(scale) if observe else None, threshold)


class StreakCostEnv(gym.Wrapper, RecordConstructorArgs):
    """`StreakCost` of an Env."""

    def __init__(self, env: gym.Env, weight: float, scale: float | None, threshold: float) -> None:
        RecordConstructorArgs.__init__(self, weight=weight, scale=scale, threshold=threshold)
        gym.Wrapper.__init__(self, env)
        self.weight, self.scale, self.threshold = weight, scale, threshold
        self._streak, self._finished = 0, False
        if scale is not None:
            self.observation_space = _with_streak(env.observation_space)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset the environment; no streak is running."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._streak, self._finished = 0, False
        return _observed(observation, 0, self.scale), info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step the environment; info["cost"] is weighted, info["plain_cost"] is not."""
        resets = self._finished and resets_itself(self.env)
        values = five(self.env, self.env.step(action))
        observation, reward, terminated, truncated, info = values
        plain = 0.0 if resets else cost_of(info)
        check_range(np.asarray(plain), "cost", low=0)
        terminated, truncated = as_flag(terminated, "terminated"), as_flag(truncated, "truncated")
        self._finished = terminated or truncated
        self._streak = self._streak + 1 if plain > self.threshold else 0
        cost = np.float64(weighted(plain, self._streak, self.weight))
        info = {**info, "cost": cost, "plain_cost": np.float64(plain)}
        observation = _observed(observation, self._streak, self.scale)
        return observation, reward, terminated, truncated, info


class StreakCostVectorEnv(VectorSteps):
    """`StreakCost` of a VectorEnv."""

    def __init__(
        self, env: VectorEnv, weight: float, scale: float | None, threshold: float
    ) -> None:
        super().__init__(env)
        self.weight, self.scale, self.threshold = weight, scale, threshold
        self._streak = np.zeros(env.num_envs, dtype=np.int64)
        if scale is not None:
            self.single_observation_space = _with_streak(env.single_observation_space)
            self.observation_space = batch_space(self.single_observation_space, env.num_envs)

    def _after_reset(self, where: NDArray[np.bool_], *result: Any) -> Any:
        observations, infos = result
        self._streak[where] = 0
        return _observed(observations, self._streak, self.scale), infos

    def _after_step(self, active: NDArray[np.bool_], done: NDArray[np.bool_], *result: Any) -> Any:
        observations, rewards, terminated, truncated, infos = result
        plain = costs_of(infos, active, done) if active.any() else np.zeros(self.num_envs)
        check_range(plain, "cost of the environments", low=0)
        self._streak = np.where(active & (plain > self.threshold), self._streak + 1, 0)
        costs = {"cost": weighted(plain, self._streak, self.weight), "plain_cost": plain}
        infos = {**infos, **_with_masks(costs, active)}
        if self._mode == AutoresetMode.SAME_STEP.value:
            if done.any():  # the costs of the last steps, the streak in the last observations
                last = infos["final_obs"].copy()
                for index in np.flatnonzero(done):
                    last[index] = _observed(last[index], self._streak[index], self.scale)
                final = {**infos.get("final_info", {}), **_with_masks(costs, done)}
                infos |= {"final_info": final, "final_obs": last}
            self._streak = np.where(done, 0, self._streak)  # of the next episodes already
        observations = _observed(observations, self._streak, self.scale)
        return observations, rewards, terminated, truncated, infos


def _observed(observation: Any, streak: Any, scale: float | None) -> Any:
    """An observation, or one of each environment, with its streak behind it."""
    if scale is None:
        return observation
    shown = np.asarray(streak / scale, observation.dtype)
    return np.concatenate((observation, shown[..., None]), axis=-1)


def _with_masks(costs: dict[str, NDArray], where: NDArray[np.bool_]) -> dict[str, Any]:
    masked = {name: np.where(where, values, 0.0) for name, values in costs.items()}
    return masked | {f"_{name}": where.copy() for name in costs}


def _with_streak(space: gym.Space) -> Box:
    """The space of observations with a streak of 0 or more behind them."""
    floats = np.issubdtype(space.dtype, np.floating)  # since k / scale is a fraction
    if not isinstance(space, Box) or len(space.shape) != 1 or not floats:
        raise TypeError(f"observe needs a flat Box of floats as observation space, got {space}")
    low, high = np.append(space.low, 0.0), np.append(space.high, np.inf)
    return Box(low.astype(space.dtype), high.astype(space.dtype), dtype=space.dtype)  # pyright: ignore[reportArgumentType]
