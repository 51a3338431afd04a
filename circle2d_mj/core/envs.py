"""The Gymnasium side of every task: seeds, resets, time limits, autoreset, one copy or many."""

from __future__ import annotations

import copy
import os
import platform
from collections.abc import Callable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from circle2d_mj.core.simulation import (
    Simulation,
    State,
    checked_action,
    of_one,
    positive_integer,
)
from circle2d_mj.core.streams import Streams, keys_of_seeds
from circle2d_mj.core.view import View

Step = tuple[Any, NDArray, NDArray, NDArray, dict[str, Any]]
"""Observations, rewards, terminated, truncated, infos."""


class TaskVectorEnv(VectorEnv[Any, NDArray[np.floating], NDArray]):
    """Copies of a task behind Gymnasium's interface for vector environments.

    Sub-environment i, seeded with `seed + i` (or with the i-th of a sequence of seeds), equals bit
    for bit a single environment with that seed, for any number of sub-environments. All three
    autoreset modes of Gymnasium are supported, as are `final_obs`, `final_info` and
    `options={"reset_mask": ...}`. In the same-step mode, `info["cost"]` and `info["x_velocity"]`
    describe the step just taken, like the reward. Numbers of the info that describe the state, such
    as `info["x_position"]`, belong in every mode to the observed state, and those in `final_info`
    to `final_obs`. Actions must be finite also for environments that only reset in a step. Without
    autoreset, an environment whose episode is over may stay where it is until its reset.
    `max_episode_steps=None` never truncates. Errors: TypeError or ValueError naming the argument;
    Gymnasium's ResetNeeded for a step before the first reset.
    """

    def __init__(
        self,
        simulation: Simulation,
        *,
        max_episode_steps: int | None,
        autoreset_mode: AutoresetMode | str,
        render_mode: str | None,
    ) -> None:
        if max_episode_steps is not None:
            positive_integer("max_episode_steps", max_episode_steps)
        self.simulation, self.num_envs = simulation, simulation.num_envs
        self.max_episode_steps = max_episode_steps
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**type(self).metadata, "autoreset_mode": self.autoreset_mode}
        # Ended episodes may wait for their reset while others step; `agents` leaves them out.
        self.metadata["ended_may_wait"] = self.autoreset_mode is AutoresetMode.DISABLED
        modes = self.metadata["render_modes"]
        if render_mode is not None and render_mode not in modes:
            valid = f"None or one of {modes} ('human' needs a screen)"
            raise ValueError(f"render_mode must be {valid}, got {render_mode!r}")
        if render_mode == "human" and self.num_envs > 1:
            raise ValueError("render_mode 'human' shows one environment; use 'rgb_array' for many")
        self.render_mode = render_mode
        self.single_observation_space = simulation.observation_space
        self.single_action_space = simulation.action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._streams: Streams | None = None
        self._steps = np.zeros(self.num_envs, dtype=np.int64)
        self._finished = np.zeros(self.num_envs, dtype=bool)
        self.recorded_info = simulation.recorded_info
        """Numbers of the info that training records at each step, with their units."""

    @property
    def view(self) -> View | None:
        """Positions to record and pictures to draw them on; None if the task has none."""
        return self.simulation.view

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Any, dict[str, Any]]:
        """Start new episodes, in all environments or in those of `options["reset_mask"]`."""
        index = self._to_reset(options)
        self._seed(seed, index)
        self._start(index)
        zeros = {key: np.zeros(self.num_envs) for key in self.simulation.info_keys}
        info = {**zeros, **self.simulation.state_info()}
        return self.simulation.observe(), self._with_masks(info)

    def step(self, actions: ArrayLike) -> Step:
        """Move every agent by its action, [num_envs, action size]."""
        checked = checked_action(actions, self.action_space.shape)
        if self.autoreset_mode is AutoresetMode.DISABLED:
            over = self._finished.any()
            self.simulation.moving = np.flatnonzero(~self._finished) if over else None
        results = self.advance(checked)
        self._with_masks(results[-1])
        return results

    def advance(self, actions: NDArray[np.float64]) -> Step:
        """Take a step with checked actions: finite, [num_envs, action size].

        The info lacks Gymnasium's masks `_cost`, ..., since every environment has a value.
        """
        if self._streams is None:
            raise ResetNeeded("reset() must be called before the first step()")
        reward, terminated, of_step = self.simulation.step(actions)
        self._steps += 1
        limit = self.max_episode_steps
        truncated = np.zeros(self.num_envs, dtype=bool) if limit is None else self._steps >= limit
        if self.autoreset_mode is AutoresetMode.NEXT_STEP:
            self._reset_finished(terminated, truncated, reward, *of_step.values())
        info: dict[str, Any] = {**of_step, **self.simulation.state_info()}
        if self.autoreset_mode is AutoresetMode.SAME_STEP:
            self._reset_now(terminated | truncated, info)
        if self.autoreset_mode is AutoresetMode.DISABLED:
            self._finished |= terminated | truncated
        return self.simulation.observe(), reward, terminated, truncated, info

    def state_dict(self) -> State:
        """Return everything that later steps and resets depend on: named arrays [num_envs, ...].

        After `load_state_dict`, this or an equal environment continues the episodes bit for bit.
        Raises ResetNeeded before the first reset.
        """
        if self._streams is None:
            raise ResetNeeded("reset() must be called before there is a state")
        return self._state_with(self._streams)

    def load_state_dict(self, state: State) -> None:
        """Load a state from `state_dict`. Raises ValueError for wrong names or shapes."""
        streams = self._streams or Streams(np.zeros(self.num_envs, dtype=np.uint64))
        own = self._state_with(streams)
        got = {name: np.shape(array) for name, array in state.items()}
        expected = {name: array.shape for name, array in own.items()}
        if got != expected:
            raise ValueError(f"state must hold arrays of the shapes {expected}, got {got}")
        state = {name: np.array(array, dtype=own[name].dtype) for name, array in state.items()}
        self._steps, self._finished = state.pop("steps"), state.pop("finished")
        streams.keys, streams.counters = state.pop("stream_keys"), state.pop("stream_counters")
        self._streams = streams
        self.simulation.load_state_dict(state)

    def _state_with(self, streams: Streams) -> State:
        return {
            "steps": self._steps.copy(),
            "finished": self._finished.copy(),
            "stream_keys": streams.keys.copy(),
            "stream_counters": streams.counters.copy(),
            **self.simulation.state_dict(),
        }

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Draw each environment, [height, width, 3] uint8 with "rgb_array"; None without a mode."""
        if self.render_mode == "human":
            self.simulation.show(0)
        if self.render_mode in (None, "human"):
            return None
        return tuple(self.picture(i) for i in range(self.num_envs))

    def picture(self, index: int) -> Any:
        """Draw environment `index` with render mode "rgb_array"; None with any other."""
        return self.simulation.frame(index) if self.render_mode == "rgb_array" else None

    def copy_of(self, index: int) -> Copy:
        """Return sub-environment `index` as a read-only `Copy`."""
        return Copy(self, index)

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Return an attribute of every sub-environment, see `Copy`."""
        return tuple(getattr(self.copy_of(i), name) for i in range(self.num_envs))

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Call a method of every sub-environment; other attributes are returned as they are."""
        found = self.get_attr(name)
        return tuple(one(*args, **kwargs) if callable(one) else one for one in found)

    def set_attr(self, name: str, values: Any) -> None:
        """Raise AttributeError: attributes of sub-environments cannot be set."""
        raise AttributeError(
            f"{name} cannot be set: all copies are stepped together with the same parameters; pass "
            f"them when the environment is made: make_vec(id, ..., {name}=...)"
        )

    def close_extras(self, **kwargs: Any) -> None:
        """Close the renderer and the viewer."""
        if hasattr(self, "simulation"):  # Gymnasium before 1.3 also closes after a failed __init__
            self.simulation.close()

    def _reset_finished(self, *results: NDArray) -> None:
        """Reset finished environments; their step has no end of episode, reward or cost."""
        index = np.flatnonzero(self._finished)
        if len(index):
            self._start(index)
            for result in results:
                result[index] = 0
        self._finished = results[0] | results[1]

    def _reset_now(self, finished: NDArray[np.bool_], info: dict[str, Any]) -> None:
        index = np.flatnonzero(finished)
        if not len(index):
            return
        final_obs = np.full(self.num_envs, None, dtype=object)
        observations = self.simulation.observe()
        for i in index.tolist():
            final_obs[i] = of_one(observations, i)
        final_info: dict[str, Any] = {}
        for key in self.simulation.info_keys:
            final_info[key] = np.where(finished, info[key], 0.0)
            final_info[f"_{key}"] = finished.copy()
        info["final_obs"], info["_final_obs"] = final_obs, finished
        info["final_info"], info["_final_info"] = final_info, finished.copy()
        self._start(index)
        info.update(self.simulation.state_info())

    def _start(self, index: NDArray[np.intp]) -> None:
        streams = self._start_streams()
        assert streams is not None
        self.simulation.start(streams, index)
        self._steps[index] = 0
        self._finished[index] = False

    def _start_streams(self) -> Streams | None:
        """Return the random streams that new episodes start from."""
        return self._streams

    def _seed(self, seed: int | Sequence[int | None] | None, index: NDArray[np.intp]) -> None:
        keys = [None] * self.num_envs if seed is None else keys_of_seeds(seed, self.num_envs)
        if seed is not None:
            # Seed np_random with the first seed, as Gymnasium expects; starts use `_streams`.
            super().reset(seed=keys[0])
        if self._streams is None:
            fresh = self.np_random.integers(2**63, size=self.num_envs, dtype=np.uint64)
            self._streams = Streams(fresh)
        if seeded := {i: keys[i] for i in index.tolist() if keys[i] is not None}:
            self._streams.reseed(np.array([*seeded]), np.array([*seeded.values()], dtype=np.uint64))

    def _to_reset(self, options: dict[str, Any] | None) -> NDArray[np.intp]:
        if unknown := set(options or {}) - {"reset_mask"}:
            raise ValueError(f"options may hold 'reset_mask' only, got {sorted(unknown)}")
        mask = (options or {}).get("reset_mask", np.ones(self.num_envs, dtype=bool))
        if not (isinstance(mask, np.ndarray) and mask.dtype == np.bool_):
            raise TypeError(f"options['reset_mask'] must be a bool array, got {mask!r}")
        if mask.shape != (self.num_envs,) or not mask.any():
            raise ValueError(
                f"options['reset_mask'] must have shape ({self.num_envs},) and at least one True, "
                f"got {mask!r}"
            )
        if self._streams is None and not mask.all():
            raise ResetNeeded("the first reset() must reset every environment, without reset_mask")
        return np.flatnonzero(mask)

    def _with_masks(self, info: dict[str, Any]) -> dict[str, Any]:
        for key in self.simulation.info_keys:
            info[f"_{key}"] = np.ones(self.num_envs, dtype=bool)
        return info


class Copy:
    """A read-only copy of the task in a vector environment, for `call` and `get_attr`.

    It has the attributes of a single environment except `reset`, `step` and `close`.
    """

    def __init__(self, envs: TaskVectorEnv, index: int) -> None:
        self._envs, self._index = envs, index
        self.observation_space = envs.single_observation_space
        self.action_space = envs.single_action_space

    def render(self) -> NDArray[np.uint8] | None:
        """Draw the copy; None unless the render mode is "rgb_array"."""
        return self._envs.picture(self._index)

    @property
    def unwrapped(self) -> Copy:
        """The copy itself."""
        return self

    def get_wrapper_attr(self, name: str) -> Any:
        """Return an attribute."""
        return getattr(self, name)

    def __getattr__(self, name: str) -> Any:
        if name in ("metadata", "render_mode", "spec", "view", "recorded_info"):
            return getattr(self._envs, name)
        raise AttributeError(f"a copy in a vector environment has no {name!r}")


class TaskEnv(gym.Env[Any, ArrayLike]):
    """One environment of a task.

    `info["cost"]` is a float (np.float64), from every step and from `reset`.
    """

    def __init__(self, envs: TaskVectorEnv) -> None:
        self._envs = envs
        self.render_mode = envs.render_mode
        own = ("autoreset_mode", "ended_may_wait")
        self.metadata = {k: v for k, v in envs.metadata.items() if k not in own}
        self.observation_space = copy.deepcopy(envs.single_observation_space)
        self.action_space = copy.deepcopy(envs.single_action_space)
        self.recorded_info = envs.recorded_info

    @property
    def view(self) -> View | None:
        """Positions to record and pictures to draw them on; None if the task has none."""
        return self._envs.view

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start a new episode."""
        seed = int(seed) if isinstance(seed, np.integer) else seed
        super().reset(seed=seed)
        observation, info = self._envs.reset(seed=seed, options=options)
        self._show()
        return of_one(observation, 0), self._floats(info)

    def step(self, action: ArrayLike) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Move the agent by its action, [action size]."""
        action = checked_action(action, self.action_space.shape)
        observation, reward, terminated, truncated, info = self._envs.advance(action[None])
        self._show()
        return (
            of_one(observation, 0),
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
        self._envs.close_extras()  # `close` would work only once

    def state_dict(self) -> State:
        """Return everything that later steps and resets depend on: see `TaskVectorEnv.state_dict`.

        With `gymnasium.make`, the time limit is a wrapper's, whose step count is not included.
        """
        return self._envs.state_dict()

    def load_state_dict(self, state: State) -> None:
        """Load a state from `state_dict`."""
        self._envs.load_state_dict(state)

    def _show(self) -> None:
        if self.render_mode == "human":
            self._envs.render()

    def _floats(self, info: dict[str, Any]) -> dict[str, np.float64]:
        # np.float64 is a float that has a dtype, which TorchRL's info reader needs.
        return {key: info[key][0] for key in self._envs.simulation.info_keys}


def without_time_limit(env: type[TaskEnv]) -> Callable[..., TaskEnv]:
    """Return an entry point for `gymnasium.make` that makes an environment without a time limit.

    Gymnasium adds its own `TimeLimit`. A second limit inside would end episodes early if a user
    raises the first, as in `make(..., max_episode_steps=100)`.
    """

    def make(**kwargs: Any) -> TaskEnv:
        return env(max_episode_steps=None, **kwargs)  # pyright: ignore[reportCallIssue]

    # Always with "human", which Gymnasium would otherwise emulate with pygame; without a screen,
    # TaskVectorEnv raises an error instead.
    modes = list(dict.fromkeys([*env.metadata["render_modes"], "human"]))
    make.metadata = env.metadata | {"render_modes": modes}  # pyright: ignore[reportFunctionMemberAccess]
    return make


def render_modes() -> list[str]:
    """Return the render modes available here: "human" only where a window could be opened."""
    has_screen = platform.system() != "Linux" or {"DISPLAY", "WAYLAND_DISPLAY"} & set(os.environ)
    return ["rgb_array", "human"] if has_screen else ["rgb_array"]
