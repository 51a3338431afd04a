"""Safety-Gymnasium's tasks as Gymnasium environments."""

# pyright: reportAttributeAccessIssue=false
# mujoco's names are defined in compiled modules, which pyright cannot read.

from __future__ import annotations

import copy
import pkgutil
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from circle2d_mj.core.engine import mujoco
from circle2d_mj.core.envs import (
    Copy,
    Step,
    TaskEnv,
    TaskVectorEnv,
    render_modes,
    without_time_limit,
)
from circle2d_mj.core.simulation import State
from circle2d_mj.core.streams import Streams, keys_of_seeds
from circle2d_mj.safety.mujoco_task import FRAME_SIZE, MuJoCoTask
from circle2d_mj.safety.navigation import NavigationTask
from circle2d_mj.safety.seen import HOW, TaskView
from circle2d_mj.safety.tasks import OLD, TASKS, SafetyTask

METADATA: dict[str, Any] = {"render_modes": [*render_modes(), "depth_array"]}


class SafetyVectorEnv(TaskVectorEnv):
    """Many copies of one of `TASKS` or `OLD`, or of a task of your own, stepped together by MuJoCo.

    Observations, actions, rewards, costs and parameters: see the task's simulation. num_threads:
    threads of MuJoCo's steps, with the same results for any number. Seeds, autoreset and errors:
    see `TaskVectorEnv`. layout_seed: every episode of every copy starts like the first episode
    after `reset(seed=layout_seed)`. Pictures show the view of a camera, chosen by name or id, with
    width x height pixels: see `MuJoCoTask.choose_picture`; with the render mode "depth_array" they
    are distances in m, float32 [height, width].
    """

    metadata = METADATA
    simulation: MuJoCoTask

    def __init__(
        self,
        task: str | SafetyTask,
        num_envs: int = 1,
        *,
        num_threads: int = 1,
        max_episode_steps: int | None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        camera_name: str | None = None,
        camera_id: int | None = None,
        width: int = FRAME_SIZE,
        height: int = FRAME_SIZE,
        layout_seed: int | None = None,
        **parameters: Any,
    ) -> None:
        known = TASKS | OLD
        if isinstance(task, str) and task not in known:
            raise ValueError(f"task must be one of {list(known)}, got {task!r}")
        found = task if isinstance(task, SafetyTask) else known[task]
        kind = found.simulation
        simulation = (pkgutil.resolve_name(kind) if isinstance(kind, str) else kind)(
            **found.arguments, num_envs=num_envs, num_threads=num_threads, **parameters
        )
        self.layout_seed = None if layout_seed is None else keys_of_seeds(layout_seed, 1)[0]
        self.registered_steps = found.max_episode_steps
        self._live: dict[int, Any] = {}
        self._live_model: Any = None
        simulation.choose_picture(camera_name, camera_id, width, height)
        super().__init__(
            simulation,
            max_episode_steps=max_episode_steps,
            autoreset_mode=autoreset_mode,
            render_mode=render_mode,
        )
        self.metadata["render_fps"] = round(1 / simulation.step_seconds)

    def picture(self, index: int) -> Any:
        """Draw environment `index` in the render mode; None without one or with "human"."""
        if self.render_mode == "depth_array":
            return self.simulation.depth(index)
        return super().picture(index)

    @property
    def live_model(self) -> Any:
        """A copy of the model with everything that is drawn."""
        if self._live_model is None:
            self._live_model = copy.copy(self.simulation.picture_model)
            self._model_bytes = _bytes(self._live_model)
        return self._live_model

    def live_data(self, index: int) -> Any:
        """Return an MjData of `live_model` that follows environment `index`. The next step raises
        RuntimeError if it was written to."""
        if index not in self._live:
            self._live[index] = self.simulation.data(index)
        return self._live[index]

    def advance(self, actions: NDArray[np.float64]) -> Step:
        """Take a step with checked actions. Raises RuntimeError if an object from `live_model` or
        `live_data` was written to."""
        if self._live or self._live_model is not None:
            self._refuse_writes()
        results = super().advance(actions)
        self._follow()
        return results

    def load_state_dict(self, state: State) -> None:
        """Load a state from `state_dict`. Raises ValueError for wrong names or shapes."""
        super().load_state_dict(state)
        self._follow()

    def _start(self, index: NDArray[np.intp]) -> None:
        super()._start(index)
        self._follow()

    def _start_streams(self) -> Streams | None:
        if self.layout_seed is None:
            return super()._start_streams()
        return Streams(np.full(self.num_envs, self.layout_seed, dtype=np.uint64))

    def _follow(self) -> None:
        for index, data in self._live.items():
            self.simulation.write(data, index)

    def _refuse_writes(self) -> None:
        task = self.simulation
        for index, data in self._live.items():
            if (data.qpos != task.qpos[index]).any() or (data.qvel != task.qvel[index]).any():
                raise RuntimeError(
                    "data is a copy of the state, and writing to it has no effect: choose starts "
                    "by make's parameters places and layout_seed; set a state by load_state_dict "
                    "or circle2d_mj.safety.original.load"
                )
        model = self._live_model
        if model is not None and not np.array_equal(_bytes(model), self._model_bytes):
            raise RuntimeError(f"model is a copy of the task's, changes have no effect: {HOW}")

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_live": {}, "_live_model": None}

    def copy_of(self, index: int) -> SafetyCopy:
        """Return sub-environment `index` as a read-only `SafetyCopy`."""
        return SafetyCopy(self, index)


class SafetyCopy(Copy):
    """A read-only copy of a task in a vector environment."""

    _envs: SafetyVectorEnv

    @property
    def task(self) -> TaskView | None:
        """The task with safety-gymnasium's attributes; None for bodies with a speed limit."""
        navigates = isinstance(self._envs.simulation, NavigationTask)
        return TaskView(self._envs, self._index) if navigates else None

    @property
    def model(self) -> Any:
        """Copy of MuJoCo's model: see `SafetyVectorEnv.live_model`."""
        return self._envs.live_model

    @property
    def data(self) -> Any:
        """Copy of MuJoCo's data: see `SafetyVectorEnv.live_data`."""
        return self._envs.live_data(self._index)

    @property
    def dt(self) -> float:
        """Seconds per environment step."""
        return self._envs.simulation.step_seconds


class SafetyEnv(TaskEnv):
    """One copy of one of `TASKS`: see `SafetyVectorEnv`."""

    metadata = METADATA

    def __init__(
        self,
        task: str | SafetyTask,
        *,
        num_threads: int = 1,
        max_episode_steps: int | None,
        render_mode: str | None = None,
        **parameters: Any,
    ) -> None:
        envs = SafetyVectorEnv(
            task,
            num_threads=num_threads,
            max_episode_steps=max_episode_steps,
            autoreset_mode=AutoresetMode.DISABLED,
            render_mode=render_mode,
            **parameters,
        )
        super().__init__(envs)
        self._copy = envs.copy_of(0)

    @property
    def task(self) -> TaskView | None:
        """The task with safety-gymnasium's attributes; None for bodies with a speed limit."""
        return self._copy.task

    @property
    def model(self) -> Any:
        """Copy of MuJoCo's model: see `SafetyVectorEnv.live_model`."""
        return self._copy.model

    @property
    def data(self) -> Any:
        """Copy of MuJoCo's data: see `SafetyVectorEnv.live_data`."""
        return self._copy.data

    @property
    def dt(self) -> float:
        """Seconds per environment step."""
        return self._copy.dt

    @property
    def obs_space_dict(self) -> Any:
        """Spaces of the parts of a navigation task's observation, by name and in order."""
        assert self.task is not None, "only navigation tasks have obs_space_dict"
        return self.task.obs_info.obs_space_dict


def _bytes(model: Any) -> NDArray[np.uint8]:
    buffer = np.empty(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return buffer


for_gym_make = without_time_limit(SafetyEnv)
