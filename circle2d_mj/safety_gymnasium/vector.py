"""Vector environments with safety-gymnasium's six values; they reset at once at an end."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from circle2d_mj.safety.six_values import SixValueVectorEnv
from circle2d_mj.safety_gymnasium.making import _check_id, as_the_originals
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

    The native vector environment steps all copies together, and `asynchronous` changes nothing;
    with `wrappers`, each applied to every copy, single environments are stepped one by one.
    max_episode_steps: None for the task's own. arguments: those of `make`; without wrappers
    `render_mode` and the task's parameters alone.
    """
    _check_id(env_id)
    if max_episode_steps is not None:  # the native environment takes None for no limit at all
        arguments["max_episode_steps"] = max_episode_steps
    if wrappers is None:
        return SafetyVectorEnv(
            gym.make_vec(
                f"circle2d_mj/{env_id}",
                num_envs=num_envs,
                vectorization_mode="vector_entry_point",
                autoreset_mode=AutoresetMode.SAME_STEP,
                **arguments,
            )
        )
    around = wrappers if isinstance(wrappers, list) else [wrappers]

    def one() -> Any:
        env: Any = make_one(env_id, disable_env_checker=disable_env_checker, **arguments)
        for wrap in around:
            env = wrap(env)
        return env

    return SafetySyncVectorEnv([one] * num_envs)


class SafetyVectorEnv(SixValueVectorEnv):
    """The native vector environment with safety-gymnasium's six values and infos: an ended
    episode's last observation is in `final_observation`, its info in `final_info`."""

    is_vector_env = True

    def reset(self, **options: Any) -> tuple[Any, dict[str, Any]]:
        """Start new episodes; the info is empty, as the original's."""
        return super().reset(**options)[0], {}

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


class SafetySyncVectorEnv:
    """Single environments with six values, made by functions, stepped one after the other."""

    is_vector_env = True

    def __init__(self, env_fns: Sequence[Callable[[], Any]], **_: Any) -> None:
        self.envs = [SafeAutoResetWrapper(make_env()) for make_env in env_fns]
        first = self.envs[0]
        self.num_envs, self.metadata, self.spec = len(self.envs), first.metadata, first.spec
        self.render_mode = first.render_mode
        self.single_observation_space = first.observation_space
        self.single_action_space = first.action_space
        self.observation_space = batch_space(first.observation_space, self.num_envs)
        self.action_space = batch_space(first.action_space, self.num_envs)

    @property
    def unwrapped(self) -> SafetySyncVectorEnv:
        """Itself."""
        return self

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Any, dict[str, Any]]:
        """Start new episodes; a whole seed stands for seed, seed + 1, ..."""
        seeds: list[Any]
        if seed is None or isinstance(seed, (int, np.integer)):
            seeds = [None if seed is None else int(seed) + i for i in range(self.num_envs)]
        else:
            seeds = list(seed)
        pairs = zip(self.envs, seeds, strict=True)
        observations = [env.reset(seed=one, options=options)[0] for env, one in pairs]
        return np.stack(observations), {}

    def step(self, actions: Any) -> Six:
        """Return observations, rewards, costs, terminated, truncated, info."""
        results = [env.step(action) for env, action in zip(self.envs, actions, strict=True)]
        values = [np.stack([np.asarray(result[k]) for result in results]) for k in range(5)]
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
        return *values, info  # pyright: ignore[reportReturnType]

    def close(self) -> None:
        """Close all environments."""
        for env in self.envs:
            env.close()


SafetyAsyncVectorEnv = SafetySyncVectorEnv
"""The environments of this package are fast enough to need no processes of their own."""


def tile_images(img_nhwc: Any, padding: int = 5) -> NDArray[Any]:
    """Lay pictures [n, height, width, colours] out in rows, as near to a square as can be.

    Each has `padding` pixels of 0 around it; places without a picture are 0.
    """
    pictures = np.pad(img_nhwc, ((0, 0), (padding, padding), (padding, padding), (0, 0)))
    rows = int(np.ceil(np.sqrt(len(pictures))))
    columns = -(-len(pictures) // rows)
    missing = rows * columns - len(pictures)
    pictures = np.pad(pictures, ((0, missing), (0, 0), (0, 0), (0, 0)))
    _, height, width, colours = pictures.shape
    grid = pictures.reshape(rows, columns, height, width, colours).swapaxes(1, 2)
    return grid.reshape(rows * height, columns * width, colours)
