"""Single environments with safety-gymnasium's six values, and the ids from which they are made."""

from __future__ import annotations

import difflib
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec, load_env_creator, spec

from circle2d_mj import registration
from circle2d_mj.safety.six_values import SixValueEnv
from circle2d_mj.safety.tasks import NAMES, OLD, VISION
from circle2d_mj.safety_gymnasium.wrappers import (
    Gymnasium2SafetyGymnasium,
    SafeAutoResetWrapper,
    SafeTimeLimit,
    SafetyGymnasium2Gymnasium,
)

__all__ = [
    "Gymnasium2SafetyGymnasium",
    "SafeMAEnv",
    "SafetyGymnasium2Gymnasium",
    "make",
    "make_gymnasium_environment",
    "make_ma",
    "register",
    "registry",
    "safe_registry",
    "spec",
]

registry: dict[str, EnvSpec] = {
    id: spec(f"circle2d_mj/{id}") for id in (*NAMES.values(), *OLD, *VISION)
}
"""Gymnasium's specifications by the ids that `make` accepts."""
safe_registry = set(registry)
"""The ids in `registry`."""
NAVIGATION_SIZE, VELOCITY_SIZE = 256, 480
"""Pixels along each side of the original's pictures."""


def register(**arguments: Any) -> None:
    """Register an environment with six values; the arguments are those of `gymnasium.register`."""
    gym.register(**arguments)
    registry[arguments["id"]] = spec(arguments["id"])
    safe_registry.add(arguments["id"])


def make(
    id: str | EnvSpec,
    max_episode_steps: int | None = None,
    autoreset: bool | None = None,
    apply_api_compatibility: bool | None = None,
    disable_env_checker: bool | None = None,
    **parameters: Any,
) -> Any:
    """Make a task of the suite, as in `make("SafetyPointGoal1-v0")`; `step` returns six values.

    autoreset: reset at once when an episode ends, see `wrappers.SafeAutoResetWrapper`. parameters:
    `render_mode` ("rgb_array", "depth_array", each also with "_list", or "human"); `camera_name` or
    `camera_id`, `width` and `height`, by default the original's: "vision" with 256 x 256 pixels, or
    "track" with 480 x 480 for bodies with a speed limit; and those of the task, such as
    `hazards=4`, see `circle2d_mj.safety.navigation.NavigationTask`.
    Raises ValueError for an id that is not in `registry`, and for apply_api_compatibility=True.
    """
    if apply_api_compatibility:
        raise ValueError("apply_api_compatibility is for gym before 0.26, which is not supported")
    own = known_id(id)
    if isinstance(id, EnvSpec):
        parameters = {**id.kwargs, **parameters}
        max_episode_steps = id.max_episode_steps if max_episode_steps is None else max_episode_steps
    if not is_own(own):
        made = _registered(own, max_episode_steps, parameters)
    else:
        five = gym.make(
            f"circle2d_mj/{own}",
            max_episode_steps=max_episode_steps,
            disable_env_checker=disable_env_checker,
            **with_pictures(own, parameters),
        )
        inner = five.unwrapped.spec
        assert inner is not None
        inner.id, inner.namespace = own, None  # code uses them in logs and names of folders
        made = SafetyGymnasiumEnv(five)
    return SafeAutoResetWrapper(made) if autoreset else made


def _registered(id: str, max_episode_steps: int | None, parameters: dict[str, Any]) -> Any:
    """Make an environment from `register`; `gymnasium.make` would expect five values."""
    found = registry[id]
    entry = found.entry_point
    creator: Any = entry if callable(entry) else load_env_creator(str(entry))
    env = creator(**{**found.kwargs, **parameters})
    env.unwrapped.spec = found
    limit = max_episode_steps or found.max_episode_steps
    return SafeTimeLimit(env, limit) if limit and limit > 0 else env


def make_gymnasium_environment(env_id: str, *args: Any, **arguments: Any) -> Any:
    """Make a task with Gymnasium's five values, by an id like `SafetyPointGoal1Gymnasium-v0`."""
    name, _, version = env_id.partition("-")
    if not name.endswith("Gymnasium"):
        raise ValueError(f"env_id must be like SafetyPointGoal1Gymnasium-v0, got {env_id!r}")
    six = make(f"{name.removesuffix('Gymnasium')}-{version}", *args, **arguments)
    return SafetyGymnasium2Gymnasium(six)


def make_ma(*args: Any, **arguments: Any) -> Any:
    """Raise NotImplementedError: there are no multi-agent tasks here."""
    raise NotImplementedError("multi-agent tasks are not here: safety-gymnasium itself has them")


class SafeMAEnv:
    """A name of the original; raises NotImplementedError when it is made: see `make_ma`."""

    def __init__(self, *args: Any, **arguments: Any) -> None:
        make_ma()


def is_own(id: str) -> bool:
    """Return whether an id names one of this package's tasks, the suite's or your own."""
    return f"circle2d_mj/{id}" in gym.registry


def known_id(id: str | EnvSpec) -> str:
    """Return the id without prefix. Raises ValueError for an unknown id."""
    own = str(getattr(id, "id", id)).removeprefix("circle2d_mj/")
    if own not in registry and not is_own(own):
        near = difflib.get_close_matches(own, registry, cutoff=0.0)
        raise ValueError(f"id must be one of `registry`, such as {', '.join(near)}, got {own!r}")
    return own


def with_pictures(id: str, parameters: dict[str, Any]) -> dict[str, Any]:
    """Return a task's parameters, with the original's camera and size as defaults."""
    velocity = "Velocity" in id
    size = VELOCITY_SIZE if velocity else NAVIGATION_SIZE
    made = {"width": size, "height": size, **parameters}
    if made.get("camera_name") is None and made.get("camera_id") is None:
        made["camera_name"] = "track" if velocity else "vision"
    return made


def known_options(options: dict[str, Any] | None) -> dict[str, Any] | None:
    """Return the reset options that have an effect here; the original ignores all options."""
    return {key: options[key] for key in ("reset_mask",) if key in options} if options else None


class SafetyGymnasiumEnv(SixValueEnv[Any, Any]):
    """An environment with safety-gymnasium's six values and infos; other attributes, such as
    `env.task`, are those of the inner environment."""

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start a new episode; the info is empty. Unknown options are ignored."""
        seed = int(seed) if isinstance(seed, np.integer) else seed
        return self.env.reset(seed=seed, options=known_options(options))[0], {}

    def step(self, action: Any) -> tuple[Any, float, float, bool, bool, dict[str, Any]]:
        """Return observation, reward, cost, terminated, truncated, info."""
        *values, info = super().step(action)
        return *values, as_the_originals(info)  # pyright: ignore[reportReturnType]

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self.env.unwrapped, name)


def as_the_originals(info: dict[str, Any]) -> dict[str, Any]:
    """Return an info with `cost_sum`, and with `goal_met` only if a goal was met."""
    found = {**info, "cost_sum": info["cost"]}
    if "goal_met" in found and not found["goal_met"]:
        del found["goal_met"]
    elif "goal_met" in found:
        found["goal_met"] = True
    return found


def _register_five_values() -> None:
    for id, found in list(registry.items()):
        plain, version = id.rsplit("-", 1)
        steps, solved = found.max_episode_steps, found.reward_threshold
        assert steps is not None
        name, env = f"{plain}Gymnasium-{version}", "safety.envs:Safety"
        registration.add(name, env, steps, reward_threshold=solved, **found.kwargs)


_register_five_values()
