"""Frames of trained policies' episodes, for tasks that can be rendered but offer no view."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import VectorEnv, VectorWrapper
from numpy.typing import NDArray
from PIL import Image

from agents.errors import UserError
from agents.lockstep.rollout import Rollout
from agents.training.config import TrainConfig
from agents.training.environments import make_envs, registered


class Filmed(NamedTuple):
    """One episode as the task itself draws it."""

    frames: list[bytes]
    """PNG files of the T + 1 states, the start first: pixels would fill the memory."""
    costs: NDArray[np.float64]
    """[T]"""


def film_episodes(
    config: TrainConfig, episodes: int, played: Callable[[VectorEnv], Rollout]
) -> list[Filmed]:
    """Episodes of one run as its task draws them.

    config: of the run alone; played: its episodes in the environments given. Raises UserError for a
    task without frames.
    """
    [task] = config.tasks
    parameters = config.task_parameters | {"render_mode": "rgb_array"}
    try:
        made = make_envs(registered(task), episodes, parameters, "sync", costs=config.costs)
    except UserError as error:
        raise _without_frames(task, error) from error
    with contextlib.closing(_KeepFrames(made, task)) as envs:
        rollout, frames = played(envs), envs.frames
    costs = rollout.cost[..., 0].astype(np.float64)
    return [
        Filmed([state[k] for state in frames[: steps + 1]], costs[:steps, k])
        for k, steps in enumerate(rollout.length)
    ]


class _KeepFrames(VectorWrapper):
    """Keeps a frame of every environment since the last reset of all of them."""

    def __init__(self, env: VectorEnv, task: str) -> None:
        super().__init__(env)
        self._task = task
        self.frames: list[list[bytes]] = []

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        found = self.env.reset(seed=seed, options=options)
        if options is None or "reset_mask" not in options:
            self.frames = [self._render()]
        return found

    def step(self, actions: Any) -> tuple[Any, NDArray, NDArray, NDArray, dict[str, Any]]:
        found = self.env.step(actions)
        self.frames.append(self._render())
        return found

    def _render(self) -> list[bytes]:
        envs: Any = self.unwrapped
        try:
            return [_png(env.render()) for env in envs.envs]
        except Exception as error:  # of the task's own code
            raise _without_frames(self._task, error) from error


def _png(frame: Any) -> bytes:
    if np.ndim(frame) != 3 or np.shape(frame)[-1] != 3:
        raise ValueError(f"render() must give [height, width, 3], got {list(np.shape(frame))}")
    file = io.BytesIO()
    Image.fromarray(np.asarray(frame, np.uint8)).save(file, "PNG", compress_level=1)
    return file.getvalue()


def _without_frames(task: str, error: Exception) -> UserError:
    return UserError(
        f"task {task!r} offers no view to draw, and no frames by render_mode 'rgb_array': {error}"
    )
