"""Single environments with safety-gymnasium's six values."""

from __future__ import annotations

import difflib
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from circle2d_mj.safety.six_values import SixValueEnv
from circle2d_mj.safety.tasks import NAMES
from circle2d_mj.safety_gymnasium.wrappers import SafeAutoResetWrapper


def make(
    id: str,
    max_episode_steps: int | None = None,
    autoreset: bool | None = None,
    disable_env_checker: bool | None = None,
    *,
    render_mode: str | None = None,
    camera_name: str | None = None,
    camera_id: int | None = None,
    width: int = 640,
    height: int = 640,
    **parameters: Any,
) -> SafetyGymnasiumEnv | SafeAutoResetWrapper:
    """Make a task of the suite, as in `make("SafetyPointGoal1-v0")`; `step` returns six values.

    autoreset: reset at once where an episode ends, see `wrappers.SafeAutoResetWrapper`. width and
    height: of pictures, pixels; a task has one view, whatever a camera's name or id. parameters: of
    the task, as in `hazards=4`, see `circle2d_mj.safety.navigation.NavigationTask`.
    Raises ValueError for an id that is not in `registry`.
    """
    _check_id(id)
    env: gym.Env = gym.make(
        f"circle2d_mj/{id}",
        max_episode_steps=max_episode_steps,
        disable_env_checker=disable_env_checker,
        render_mode=render_mode,
        **parameters,
    )
    made = SafetyGymnasiumEnv(env, width, height)
    return SafeAutoResetWrapper(made) if autoreset else made


def _check_id(id: str) -> None:
    if id not in NAMES.values():
        near = difflib.get_close_matches(str(id), NAMES.values(), cutoff=0.0)
        raise ValueError(f"id must be one of `registry`, such as {', '.join(near)}, got {id!r}")


class SafetyGymnasiumEnv(SixValueEnv[Any, Any]):
    """An environment with safety-gymnasium's six values and infos; other attributes are those of
    the task inside, as in `env.task`."""

    def __init__(self, env: gym.Env, width: int = 640, height: int = 640) -> None:
        super().__init__(env)
        self._size = width, height

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start a new episode; the info is empty."""
        return self.env.reset(seed=seed, options=options)[0], {}

    def step(self, action: Any) -> tuple[Any, float, float, bool, bool, dict[str, Any]]:
        """Return observation, reward, cost, terminated, truncated, info."""
        *values, info = super().step(action)
        return *values, as_the_originals(info)  # pyright: ignore[reportReturnType]

    def render(self) -> Any:
        """Draw the environment: [height, width, 3] uint8."""
        picture: NDArray[np.uint8] | None = self.env.render()  # pyright: ignore
        if picture is None or picture.shape[1::-1] == self._size:
            return picture
        return np.asarray(Image.fromarray(picture).resize(self._size, Image.Resampling.LANCZOS))

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self.env.unwrapped, name)


def as_the_originals(info: dict[str, Any]) -> dict[str, Any]:
    """Return an info with `cost_sum`, and with `goal_met` only where a goal was met."""
    found = {**info, "cost_sum": info["cost"]}
    if "goal_met" in found and not found["goal_met"]:
        del found["goal_met"]
    elif "goal_met" in found:
        found["goal_met"] = True
    return found
