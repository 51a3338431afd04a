"""Vector environments with safety-gymnasium's six values, which reset when an episode ends."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space, concatenate, create_empty_array
from numpy.typing import NDArray

from circle2d_mj.safety.six_values import SixValueVectorEnv
from circle2d_mj.safety_gymnasium.making import (
    as_the_originals,
    is_own,
    known_id,
    known_options,
    with_pictures,
)
from circle2d_mj.safety_gymnasium.making import make as make_one
from circle2d_mj.safety_gymnasium.wrappers import SafeAutoResetWrapper, Six

Wrap = Callable[[Any], Any]


def make(
    env_id: str,
    num_envs: int = 1,
    asynchronous: bool = True,
    wrappers: Wrap | list[Wrap] | None = None,
    disable_env_checker: bool | None = None,
    *,
    max_episode_steps: int | None = None,
    **arguments: Any,
) -> Any:
    """Make copies of a task of the suite; `step` returns six values, arrays [num_envs, ...].

    The native vector environment steps all copies together; `asynchronous` has no effect. With
    `wrappers`, each of which is applied to every copy, and for ids from `register`, single
    environments are stepped one after another.
    max_episode_steps: None for the task's own. arguments: the further arguments of `making.make`.
    """
    own = known_id(env_id)
    if max_episode_steps is not None:  # to the native environment, None means no limit
        arguments["max_episode_steps"] = max_episode_steps
    if wrappers is None and is_own(own):
        return SafetyVectorEnv(
            gym.make_vec(
                f"circle2d_mj/{own}",
                num_envs=num_envs,
                vectorization_mode="vector_entry_point",
                autoreset_mode=AutoresetMode.SAME_STEP,
                **with_pictures(own, arguments),
            )
        )
    around = [wrappers] if callable(wrappers) else wrappers or []

    def one() -> Any:
        env: Any = make_one(own, disable_env_checker=disable_env_checker, **arguments)
        for wrap in around:
            env = wrap(env)
        return env

    return SafetySyncVectorEnv([one] * num_envs)


class _Asynchronous:
    """`step` in two halves, for code that is written for environments in processes."""

    def step_async(self, actions: Any) -> None:
        """Keep the actions for `step_wait`."""
        self._waiting = actions

    def step_wait(self, timeout: float | None = None) -> Six:
        """Take the step and return its six values."""
        return self.step(self._waiting)  # pyright: ignore[reportAttributeAccessIssue]


class SafetyVectorEnv(_Asynchronous, SixValueVectorEnv):
    """The native vector environment with safety-gymnasium's six values and infos. The last
    observation of an ended episode is in `final_observation`, the last info in `final_info`."""

    is_vector_env = True

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start new episodes; the info is empty, like the original's. The only option with an
        effect is Gymnasium's `reset_mask`."""
        return super().reset(seed=seed, options=known_options(options))[0], {}

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Return an attribute of every sub-environment, as in `get_attr("task")`."""
        return self.env.get_attr(name)  # pyright: ignore[reportAttributeAccessIssue]

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Call a method of every sub-environment; other attributes are returned as they are."""
        return self.env.call(name, *args, **kwargs)  # pyright: ignore[reportAttributeAccessIssue]

    def set_attr(self, name: str, values: Any) -> None:
        """Raise AttributeError, which says what to do instead."""
        self.env.set_attr(name, values)  # pyright: ignore[reportAttributeAccessIssue]

    def step(self, actions: Any) -> Six:
        """Return observations, rewards, costs, terminated, truncated, info."""
        *values, info = super().step(actions)
        info["cost_sum"], info["_cost_sum"] = info["cost"], info["_cost"]
        met = np.asarray(info.pop("goal_met", 0.0), dtype=bool)
        info.pop("_goal_met", None)
        if met.any():
            info["goal_met"], info["_goal_met"] = met, met.copy()
        if "final_obs" in info:
            finals, ended = info.pop("final_info"), info.pop("_final_obs")
            info["final_observation"], info["_final_observation"] = info.pop("final_obs"), ended
            numbers = [key for key in finals if not key.startswith("_")]
            infos = np.full(self.num_envs, None, dtype=object)
            for i in np.flatnonzero(ended):
                infos[i] = as_the_originals({key: finals[key][i] for key in numbers})
            info["final_info"] = infos
        return *values, info  # pyright: ignore[reportReturnType]


class SafetySyncVectorEnv(_Asynchronous, VectorEnv):
    """Single environments with six values, made by functions and stepped one after another."""

    is_vector_env = True

    def __init__(self, env_fns: Sequence[Callable[[], Any]], **_: Any) -> None:
        self.envs = [SafeAutoResetWrapper(make_env()) for make_env in env_fns]
        first = self.envs[0]
        self.num_envs, self.spec, self.render_mode = len(self.envs), first.spec, first.render_mode
        self.metadata = {**first.metadata, "autoreset_mode": AutoresetMode.SAME_STEP}
        self.single_observation_space = first.observation_space
        self.single_action_space = first.action_space
        self.observation_space = batch_space(first.observation_space, self.num_envs)
        self.action_space = batch_space(first.action_space, self.num_envs)

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Call a method of every sub-environment; other attributes are returned as they are."""
        found = self.get_attr(name)
        return tuple(one(*args, **kwargs) if callable(one) else one for one in found)

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Return an attribute of every sub-environment."""
        return tuple(env.get_wrapper_attr(name) for env in self.envs)

    def set_attr(self, name: str, values: Any) -> None:
        """Set an attribute of every sub-environment to one value, or to the values of a list."""
        each = values if isinstance(values, (list, tuple)) else [values] * self.num_envs
        for env, value in zip(self.envs, each, strict=True):
            env.set_wrapper_attr(name, value)

    def render(self) -> tuple[Any, ...]:
        """Draw every sub-environment."""
        return self.call("render")

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Any, dict[str, Any]]:
        """Start new episodes; an integer seed stands for seed, seed + 1, ..."""
        seeds: list[Any]
        if seed is None or isinstance(seed, (int, np.integer)):
            seeds = [None if seed is None else int(seed) + i for i in range(self.num_envs)]
        else:
            seeds = list(seed)
        pairs = zip(self.envs, seeds, strict=True)
        observations = [env.reset(seed=one, options=options)[0] for env, one in pairs]
        return self._together(observations), {}

    def step(self, actions: Any) -> Six:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Return observations, rewards, costs, terminated, truncated, info."""
        results = [env.step(action) for env, action in zip(self.envs, actions, strict=True)]
        values = [np.stack([np.asarray(result[k]) for result in results]) for k in range(1, 5)]
        observations = self._together([result[0] for result in results])
        info: dict[str, Any] = {}
        for i, result in enumerate(results):
            for key, value in result[5].items():
                if key not in info:
                    number = isinstance(value, (float, np.floating))
                    empty = np.zeros(self.num_envs) if number else None
                    info[key] = (
                        np.full(self.num_envs, None, dtype=object) if empty is None else empty
                    )
                    info[f"_{key}"] = np.zeros(self.num_envs, dtype=bool)
                info[key][i], info[f"_{key}"][i] = value, True
        return observations, *values, info  # pyright: ignore[reportReturnType]

    def _together(self, observations: list[Any]) -> Any:
        space = self.single_observation_space
        return concatenate(space, observations, create_empty_array(space, self.num_envs))

    def close_extras(self, **_: Any) -> None:
        """Close all environments."""
        for env in getattr(self, "envs", ()):  # Gymnasium < 1.3 also closes after a failed __init__
            env.close()


SafetyAsyncVectorEnv = SafetySyncVectorEnv
"""Synchronous as well: this package's environments are fast enough without processes."""


def tile_images(img_nhwc: Any, padding: int = 5) -> NDArray[Any]:
    """Arrange pictures [n, height, width, colours] in rows, as close to a square as possible.

    Each picture gets `padding` pixels of 0 around it; places without a picture are 0.
    """
    pictures = np.pad(img_nhwc, ((0, 0), (padding, padding), (padding, padding), (0, 0)))
    rows = int(np.ceil(np.sqrt(len(pictures))))
    columns = -(-len(pictures) // rows)
    missing = rows * columns - len(pictures)
    pictures = np.pad(pictures, ((0, missing), (0, 0), (0, 0), (0, 0)))
    _, height, width, colours = pictures.shape
    grid = pictures.reshape(rows, columns, height, width, colours).swapaxes(1, 2)
    return grid.reshape(rows * height, columns * width, colours)
