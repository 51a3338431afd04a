"""The environments: one vector environment, and the single one as its view of size 1."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from circle2d_mj import task
from circle2d_mj.config import Circle2DConfig
from circle2d_mj.kinematic import Kinematic
from circle2d_mj.streams import Streams, keys_of_seeds

MAX_EPISODE_STEPS = 50


class Circle2DVectorEnv(VectorEnv[NDArray[np.float32], NDArray[np.floating], NDArray]):
    """Many Circle2D tasks stepped together in numpy.

    | | shape | meaning |
    | --- | --- | --- |
    | observation | [num_envs, 2] float32 | x and y over the arena's half-width, in [-1, 1] |
    | action | [num_envs, 2] | step on x and y over 0.11 R, clipped to [-1, 1] |
    | reward | [num_envs] float64 | minus the distance to the optimum over the half-diagonal |
    | `info["cost"]` | [num_envs] float64 | 1.0 where the step ended in the cost region, else 0.0 |

    Sub-environment i seeded with `seed + i` (or with the i-th of a sequence of seeds) runs bit for
    bit as a single environment with that seed, whatever the number of its neighbours. All three
    autoreset modes of gymnasium are kept, with its contract for `final_obs`, `final_info` and
    `options={"reset_mask": ...}`. In the same-step mode `info["cost"]` is, like the reward, that of
    the step just taken. Actions of environments that only reset in a step must be finite too.

    The task is given as a `Circle2DConfig` or by its parameters: `Circle2DVectorEnv(8, level=2)`.
    `max_episode_steps=None` never truncates. Errors: TypeError or ValueError naming the argument;
    gymnasium's ResetNeeded for a step before the first reset.
    """

    def __init__(
        self,
        num_envs: int = 1,
        *,
        config: Circle2DConfig | None = None,
        max_episode_steps: int | None = MAX_EPISODE_STEPS,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        **parameters: Any,
    ) -> None:
        self.config = Circle2DConfig.of(config, parameters)
        self.num_envs = _positive_integer("num_envs", num_envs)
        if max_episode_steps is not None:
            _positive_integer("max_episode_steps", max_episode_steps)
        if render_mode is not None:
            raise ValueError(f"render_mode must be None (no renderer yet), got {render_mode!r}")
        self.max_episode_steps = max_episode_steps
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {"render_modes": [], "autoreset_mode": self.autoreset_mode}
        self.render_mode = render_mode
        self._dynamics = Kinematic(self.config, num_envs)
        self.single_observation_space = self._dynamics.observation_space
        self.single_action_space = Box(-1.0, 1.0, (2,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._streams: Streams | None = None
        self._steps = np.zeros(num_envs, dtype=np.int64)
        self._finished = np.zeros(num_envs, dtype=bool)

    @property
    def position(self) -> NDArray[np.float64]:
        """Where the agents are, world units: [num_envs, 2], a copy."""
        return self._dynamics.position.copy()

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Start new episodes, in all environments or where `options["reset_mask"]` says."""
        index = self._to_reset(options)
        self._seed(seed, index)
        self._start(index)
        return self._dynamics.observe(), self._info(np.zeros(self.num_envs))

    def step(
        self, actions: ArrayLike
    ) -> tuple[NDArray[np.float32], NDArray, NDArray, NDArray, dict[str, Any]]:
        """Move every agent by its action, [num_envs, 2]; see the class for what comes back."""
        return self.advance(checked_action(actions, (self.num_envs, 2)))

    def advance(
        self, actions: NDArray[np.float64]
    ) -> tuple[NDArray[np.float32], NDArray, NDArray, NDArray, dict[str, Any]]:
        """`step` for actions that have been checked: finite, [num_envs, 2]."""
        if self._streams is None:
            raise ResetNeeded("reset() must be called before the first step()")
        cost = self._dynamics.step(actions)
        reward = task.reward(self.config, self._dynamics.position)
        self._steps += 1
        never = np.zeros(self.num_envs, dtype=bool)
        limit = self.max_episode_steps
        terminated = cost > 0 if self.config.reset_on_cost else never
        truncated = never.copy() if limit is None else self._steps >= limit
        if self.autoreset_mode is AutoresetMode.NEXT_STEP:
            self._reset_finished(reward, cost, terminated, truncated)
        info = self._info(cost)
        if self.autoreset_mode is AutoresetMode.SAME_STEP:
            self._reset_now(terminated | truncated, info)
        return self._dynamics.observe(), reward, terminated, truncated, info

    def _reset_finished(self, reward: NDArray, cost: NDArray, *ends: NDArray) -> None:
        """What follows an episode's last step is a reset: no reward, no cost, no end."""
        index = np.flatnonzero(self._finished)
        if len(index):
            self._start(index)
            for result in (reward, cost, *ends):
                result[index] = 0
        self._finished = ends[0] | ends[1]

    def _reset_now(self, finished: NDArray[np.bool_], info: dict[str, Any]) -> None:
        index = np.flatnonzero(finished)
        if not len(index):
            return
        final_obs = np.full(self.num_envs, None, dtype=object)
        for i, observation in zip(index, self._dynamics.observe()[index], strict=True):
            final_obs[i] = observation
        info["final_obs"], info["_final_obs"] = final_obs, finished
        final_cost = np.where(finished, info["cost"], 0.0)
        info["final_info"] = {"cost": final_cost, "_cost": finished.copy()}
        info["_final_info"] = finished.copy()
        self._start(index)

    def _start(self, index: NDArray[np.intp]) -> None:
        assert self._streams is not None
        start = self.config.start_area.sample(self._streams, index)
        self._dynamics.place(index, start)
        self._steps[index] = 0
        self._finished[index] = False

    def _seed(self, seed: int | Sequence[int | None] | None, index: NDArray[np.intp]) -> None:
        keys = [None] * self.num_envs if seed is None else keys_of_seeds(seed, self.num_envs)
        if seed is not None:
            # np_random follows the first seed, as gymnasium expects; starts have their own streams.
            super().reset(seed=keys[0])
        if self._streams is None:
            fresh = self.np_random.integers(2**63, size=self.num_envs, dtype=np.uint64)
            self._streams = Streams(fresh)
        seeded = [i for i in index if keys[i] is not None]
        if seeded:
            values = np.array([keys[i] for i in seeded], dtype=np.uint64)
            self._streams.reseed(np.array(seeded), values)

    def _to_reset(self, options: dict[str, Any] | None) -> NDArray[np.intp]:
        options = options or {}
        if unknown := set(options) - {"reset_mask"}:
            raise ValueError(f"options may hold 'reset_mask' only, got {sorted(unknown)}")
        if "reset_mask" not in options:
            return np.arange(self.num_envs)
        mask = options["reset_mask"]
        if not (isinstance(mask, np.ndarray) and mask.dtype == np.bool_):
            raise TypeError(f"options['reset_mask'] must be a bool array, got {mask!r}")
        if mask.shape != (self.num_envs,) or not mask.any():
            raise ValueError(
                f"options['reset_mask'] must have shape ({self.num_envs},) and one True at least, "
                f"got {mask!r}"
            )
        if self._streams is None and not mask.all():
            raise ResetNeeded("the first reset() must reset every environment, without reset_mask")
        return np.flatnonzero(mask)

    def _info(self, cost: NDArray[np.float64]) -> dict[str, Any]:
        return {"cost": cost, "_cost": np.ones(self.num_envs, dtype=bool)}


class Circle2DEnv(gym.Env[NDArray[np.float32], NDArray[np.floating]]):
    """One Circle2D task: the vector environment of size 1 without its first axis.

    Observation, action and reward are those of `Circle2DVectorEnv`; `info["cost"]` is a float, on
    every step and from `reset`. The task is given as a `Circle2DConfig` or by its parameters.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012, as gymnasium declares it

    def __init__(
        self,
        config: Circle2DConfig | None = None,
        *,
        max_episode_steps: int | None = MAX_EPISODE_STEPS,
        render_mode: str | None = None,
        **parameters: Any,
    ) -> None:
        self._envs = Circle2DVectorEnv(
            config=config,
            max_episode_steps=max_episode_steps,
            autoreset_mode=AutoresetMode.DISABLED,
            render_mode=render_mode,
            **parameters,
        )
        self.config = self._envs.config
        self.render_mode = render_mode
        self.observation_space = copy.deepcopy(self._envs.single_observation_space)
        self.action_space = copy.deepcopy(self._envs.single_action_space)

    @property
    def position(self) -> NDArray[np.float64]:
        """Where the agent is, world units: [2], a copy."""
        return self._envs.position[0]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Start a new episode."""
        super().reset(seed=seed)
        observation, info = self._envs.reset(seed=seed, options=options)
        return observation[0], {"cost": float(info["cost"][0])}

    def step(
        self, action: ArrayLike
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Move the agent by its action, [2]."""
        action = checked_action(action, (2,))
        observation, reward, terminated, truncated, info = self._envs.advance(action[None])
        return (
            observation[0],
            float(reward[0]),
            bool(terminated[0]),
            bool(truncated[0]),
            {"cost": float(info["cost"][0])},
        )


def for_gym_make(**kwargs: Any) -> Circle2DEnv:
    """What `gymnasium.make` calls: without a time limit, since it adds its own `TimeLimit`.

    A second limit inside would cut short whoever raises it by `make(..., max_episode_steps=100)`.
    """
    return Circle2DEnv(max_episode_steps=None, **kwargs)


for_gym_make.metadata = Circle2DEnv.metadata  # pyright: ignore[reportFunctionMemberAccess]


def checked_action(action: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """The action as float64. Raises ValueError where it has another shape or is not finite."""
    try:
        values = np.asarray(action, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"action must be numbers of shape {shape}, got {action!r}") from None
    if values.shape != shape:
        raise ValueError(f"action must have shape {shape}, got shape {values.shape}")
    if not np.isfinite(values).all():
        raise ValueError(f"action must be finite, got {action!r}")
    return values


def _positive_integer(name: str, value: Any) -> int:
    if not isinstance(value, (int, np.integer)) or isinstance(value, bool):
        raise TypeError(f"{name} must be an integer, got {value!r}")
    if value < 1:
        raise ValueError(f"{name} must be at least 1, got {value!r}")
    return int(value)
