"""Conversion between Gymnasium's five values of a step and Safety-Gymnasium's six."""

from __future__ import annotations

from numbers import Real
from typing import Any, TypeVar, overload

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Box, Discrete, Space
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from numpy.typing import NDArray

Observation = TypeVar("Observation")
Action = TypeVar("Action")


class SixValueEnv(gym.Wrapper[Observation, Action, Observation, Action]):
    """A single environment whose `step` returns six values: see `SafetyGymnasiumAPI`."""

    def step(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, action: Action
    ) -> tuple[Observation, float, float, bool, bool, dict[str, Any]]:
        """Return observation, reward, cost, terminated, truncated, info."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        _require_cost(info)
        cost = _number(info["cost"], self.env)
        return observation, float(reward), cost, terminated, truncated, info


class SixValueVectorEnv(VectorWrapper):
    """A vector environment whose `step` returns six values: see `SafetyGymnasiumAPI`."""

    def __init__(self, env: VectorEnv) -> None:
        super().__init__(env)
        mode = env.metadata.get("autoreset_mode")
        self._waits_to_reset = mode in (AutoresetMode.NEXT_STEP, AutoresetMode.NEXT_STEP.value)
        self._resetting = np.zeros(env.num_envs, dtype=bool)
        """[num_envs] environments whose next step only resets."""

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start new episodes."""
        self._resetting &= ~np.asarray((options or {}).get("reset_mask", True))
        return self.env.reset(seed=seed, options=options)

    def step(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, actions: Any
    ) -> tuple[Any, NDArray[Any], NDArray[np.float64], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Return observations, rewards, costs, terminated, truncated, infos."""
        observation, reward, terminated, truncated, info = self.env.step(actions)
        ended = np.asarray(terminated, dtype=bool) | np.asarray(truncated, dtype=bool)
        cost = self._costs(info, ended)
        if self._waits_to_reset:
            self._resetting = ended & ~self._resetting
        return observation, reward, cost, terminated, truncated, info

    def _costs(self, info: dict[str, Any], ended: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Return each step's cost; in SAME_STEP mode `info` already belongs to the next episode.

        The rule is the same as in `emcc.recorder.costs_of`; this package does not import emcc.
        """
        final = info.get("final_info", {})
        of_final = ended & ("cost" in final)
        costs = np.zeros(self.num_envs)
        for given, where in ((final, of_final), (info, ~of_final & ~self._resetting)):
            if where.any():
                _require_cost(given)
                costs[where] = _given_costs(given, where)[where]
        return costs


@overload
def SafetyGymnasiumAPI(env: VectorEnv) -> SixValueVectorEnv: ...
@overload
def SafetyGymnasiumAPI(env: gym.Env[Observation, Action]) -> SixValueEnv[Observation, Action]: ...
def SafetyGymnasiumAPI(env: gym.Env | VectorEnv) -> SixValueEnv | SixValueVectorEnv:
    """Wrap an environment so that `step` returns the cost as a separate value.

    `step(action) -> observation, reward, cost, terminated, truncated, info`; `cost` is
    `info["cost"]`, a float or, for a vector environment, a float array [num_envs]. In SAME_STEP
    mode the cost of an episode's last step is taken from `final_info`; in NEXT_STEP mode the step
    that only resets costs 0. Any single or vector environment with `info["cost"]` is accepted; the
    sub-environments of Gymnasium's vector environments must return the cost as a float. TypeError:
    not an environment, or a cost of another type. KeyError: a step without a cost.
    """
    if isinstance(env, VectorEnv):
        return SixValueVectorEnv(env)
    if isinstance(env, gym.Env):
        return SixValueEnv(env)
    raise TypeError(f"env must be a gymnasium Env or VectorEnv, got {env!r}")


def _given_costs(info: dict[str, Any], needed: NDArray[np.bool_]) -> NDArray[Any]:
    """Return info["cost"] as an array. The mask info["_cost"], which Gymnasium's vector
    environments add, must cover `needed`; with the mask, integers and bools are an error."""
    missing = needed & ~np.asarray(info.get("_cost", needed), dtype=bool)
    if missing.any():
        raise KeyError(f"sub-environment {missing.argmax()} gave no 'cost' in its info")
    costs = np.asarray(info["cost"])
    if "_cost" in info and costs.dtype.kind in "biu":
        raise TypeError(
            f"info['cost'] came as {costs.dtype}: gymnasium's vector environments give all costs "
            "the type of the first, which may have rounded others; return every cost as a float"
        )
    return costs.reshape(needed.shape)


def _number(cost: Any, env: Any) -> np.float64:
    if not isinstance(cost, (Real, np.number, np.bool_)):
        raise TypeError(f"the cost from {env!r} must be a number, got {cost!r}")
    return np.float64(cost)


def _require_cost(info: dict[str, Any]) -> None:
    if "cost" not in info:
        raise KeyError(f"info has no 'cost'; its keys are {sorted(info)}")


class FromSafetyGymnasium(gym.Env):
    """A Gymnasium environment around one whose `step` returns Safety-Gymnasium's six values.

    `step` returns Gymnasium's five values and `info["cost"]`, a float (np.float64); `reset`'s info
    has cost 0.0.
    The inner environment need not be a `gymnasium.Env`: a Box or Discrete of another package is
    copied by its attributes. `render` and `close` are passed through. A seed above 2**32 - 1, which
    NumPy's RandomState in older environments refuses, is replaced by
    `numpy.random.SeedSequence(seed).generate_state(1)[0]`.

    To train on a task of Safety-Gymnasium by `circle2d train --task my_tasks:Goal-v0`, write a
    module my_tasks.py with

        gym.register(
            id="Goal-v0",
            entry_point=lambda **kw: FromSafetyGymnasium(
                safety_gymnasium.make("SafetyPointGoal1-v0", **kw)
            ),
        )

    Raises TypeError for an object that is no environment, for other kinds of spaces and for costs
    that are not numbers; ValueError if `step` or `reset` returns a wrong number of values.
    """

    def __init__(self, env: Any) -> None:
        needed = ("reset", "step", "observation_space", "action_space")
        if missing := [name for name in needed if not hasattr(env, name)]:
            raise TypeError(f"env must be an environment; {env!r} has no {', '.join(missing)}")
        self.env = env
        self.observation_space = _as_gymnasium(env.observation_space, "observation_space")
        self.action_space = _as_gymnasium(env.action_space, "action_space")
        self.metadata = dict(getattr(env, "metadata", None) or {"render_modes": []})
        self.render_mode = getattr(env, "render_mode", None)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start a new episode."""
        super().reset(seed=seed)
        arguments: dict[str, Any] = {} if options is None else {"options": options}
        if seed is not None:
            small = seed < 2**32
            arguments["seed"] = (
                seed if small else int(np.random.SeedSequence(seed).generate_state(1)[0])
            )
        observation, info = _values(self.env, "reset", self.env.reset(**arguments), 2)
        return observation, {**info, "cost": np.float64(0.0)}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Take a step; the cost is in the info."""
        values = _values(self.env, "step", self.env.step(action), 6)
        observation, reward, cost, terminated, truncated, info = values
        info = {**info, "cost": _number(cost, self.env)}
        return observation, float(reward), bool(terminated), bool(truncated), info

    def render(self) -> Any:
        """Render the environment."""
        return self.env.render()

    def close(self) -> None:
        """Close the environment, if it can be closed."""
        if hasattr(self.env, "close"):
            self.env.close()


def _values(env: Any, method: str, result: Any, count: int) -> tuple[Any, ...]:
    if isinstance(result, tuple) and len(result) == count:
        return result
    got = f"{len(result)} values" if isinstance(result, tuple) else type(result).__name__
    raise ValueError(f"{method} of {env!r} must return {count} values, got {got}")


def _as_gymnasium(space: Any, name: str) -> Space:
    if isinstance(space, Space):
        return space
    if all(hasattr(space, attribute) for attribute in ("low", "high", "shape", "dtype")):
        return Box(space.low, space.high, tuple(space.shape), space.dtype)
    if hasattr(space, "n"):
        return Discrete(int(space.n), start=int(getattr(space, "start", 0)))
    raise TypeError(f"{name} must be a Box or Discrete, got {space!r}")
