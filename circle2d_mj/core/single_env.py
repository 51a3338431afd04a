"""One environment of a task: the vector environment of size 1 without its first axis."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike, NDArray

from circle2d_mj.core.simulation import State, checked_action
from circle2d_mj.core.vector_env import TaskVectorEnv
from circle2d_mj.core.view import View


class TaskEnv(gym.Env[NDArray[np.floating], ArrayLike]):
    """One environment of a task.

    `info["cost"]` is a float (numpy's float64), on every step and from `reset`.
    """

    def __init__(self, envs: TaskVectorEnv) -> None:
        self._envs = envs
        self.render_mode = envs.render_mode
        self.metadata = {k: v for k, v in envs.metadata.items() if k != "autoreset_mode"}
        self.observation_space = copy.deepcopy(envs.single_observation_space)
        self.action_space = copy.deepcopy(envs.single_action_space)

    @property
    def view(self) -> View | None:
        """Positions to record and pictures to draw them on; None without."""
        return self._envs.view

    @property
    def recorded_info(self) -> dict[str, str]:
        """Numbers of the info that training records at each step, with their units."""
        return self._envs.recorded_info

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.floating], dict[str, Any]]:
        """Start a new episode."""
        super().reset(seed=seed)
        observation, info = self._envs.reset(seed=seed, options=options)
        self._show()
        return observation[0], self._floats(info)

    def step(
        self, action: ArrayLike
    ) -> tuple[NDArray[np.floating], float, bool, bool, dict[str, Any]]:
        """Move the agent by its action, [action size]."""
        action = checked_action(action, self.action_space.shape)
        observation, reward, terminated, truncated, info = self._envs.advance(action[None])
        self._show()
        return (
            observation[0],
            float(reward[0]),
            bool(terminated[0]),
            bool(truncated[0]),
            self._floats(info),
        )

    def render(self) -> NDArray[np.uint8] | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Draw the environment, [height, width, 3] uint8; None without render_mode "rgb_array"."""
        frames = self._envs.render()
        return None if frames is None else frames[0]

    def close(self) -> None:
        """Close the renderer and the viewer."""
        self._envs.close_extras()  # `close` would do so only once

    def state_dict(self) -> State:
        """Return all that later steps and resets depend on: see `TaskVectorEnv.state_dict`.

        The time limit of an environment from `gymnasium.make` is a wrapper's, and not part of it.
        """
        return self._envs.state_dict()

    def load_state_dict(self, state: State) -> None:
        """Load a state."""
        self._envs.load_state_dict(state)

    def _show(self) -> None:
        if self.render_mode == "human":
            self._envs.render()

    def _floats(self, info: dict[str, Any]) -> dict[str, np.float64]:
        # numpy's float64 is a Python float with a dtype, which TorchRL's info reader needs.
        return {key: info[key][0] for key in self._envs.simulation.info_keys}


def without_time_limit(env: type[TaskEnv]) -> Callable[..., TaskEnv]:
    """Return the function by which `gymnasium.make` makes an environment, without a time limit.

    gymnasium adds its own `TimeLimit`. A second limit inside would end episodes early where a user
    raises the first, as in `make(..., max_episode_steps=100)`.
    """

    def make(**kwargs: Any) -> TaskEnv:
        return env(max_episode_steps=None, **kwargs)  # pyright: ignore[reportCallIssue]

    make.metadata = env.metadata  # pyright: ignore[reportFunctionMemberAccess]
    return make
