"""Safety-Gymnasium's tasks as gymnasium environments."""

from __future__ import annotations

import pkgutil
from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from circle2d_mj.core.envs import Copy, TaskEnv, TaskVectorEnv, render_modes, without_time_limit
from circle2d_mj.safety.mujoco_task import FRAME_SIZE
from circle2d_mj.safety.tasks import TASKS

METADATA: dict[str, Any] = {"render_modes": [*render_modes(), "depth_array"]}


class SafetyVectorEnv(TaskVectorEnv):
    """Many copies of one of `TASKS`, stepped together by MuJoCo.

    Observations, actions, rewards, costs and parameters: see the task's simulation. num_threads:
    for MuJoCo's steps; it changes no number. Seeds, autoreset and errors: see `TaskVectorEnv`.
    Pictures: of a camera by name or id, width x height pixels, see `MuJoCoTask.choose_picture`;
    with the render mode "depth_array" distances, m, float32 [height, width].
    """

    metadata = METADATA

    def __init__(
        self,
        task: str,
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
        **parameters: Any,
    ) -> None:
        if task not in TASKS:
            raise ValueError(f"task must be one of {list(TASKS)}, got {task!r}")
        found = TASKS[task]
        simulation = pkgutil.resolve_name(found.simulation)(
            **found.arguments, num_envs=num_envs, num_threads=num_threads, **parameters
        )
        simulation.choose_picture(camera_name, camera_id, width, height)
        super().__init__(
            simulation,
            max_episode_steps=max_episode_steps,
            autoreset_mode=autoreset_mode,
            render_mode=render_mode,
        )
        self.metadata["render_fps"] = round(1 / simulation.step_seconds)

    def picture(self, index: int) -> Any:
        """Draw environment `index` in the render mode; None without one, and in a window."""
        if self.render_mode == "depth_array":
            simulation: Any = self.simulation
            return simulation.depth(index)
        return super().picture(index)

    def copy_of(self, index: int) -> SafetyCopy:
        """Return sub-environment `index`, to read from."""
        return SafetyCopy(self, index)


class Seen(NamedTuple):
    """Objects of one kind."""

    pos: Any
    """[3] m, or a list of such arrays where there may be several"""
    size: float


class SeenAgent:
    """The agent under safety-gymnasium's names, all in the world but the sensors."""

    def __init__(self, simulation: Any, index: int) -> None:
        self._simulation, self._index = simulation, index

    @property
    def pos(self) -> NDArray[np.float64]:
        """Its origin, [3] m."""
        return self._simulation.positions("agent")[self._index, 0]

    @property
    def mat(self) -> NDArray[np.float64]:
        """Its rotation matrix, [3, 3]: columns are its axes."""
        return self._simulation.rotations[self._index, 0].copy()

    @property
    def vel(self) -> NDArray[np.float64]:
        """The velocity of its origin, [3] m/s."""
        return self.mat @ self.get_sensor("velocimeter")

    def get_sensor(self, name: str) -> NDArray[np.float64]:
        """Return what a sensor of the agent's model reads, as in "velocimeter": [3]."""
        sensor = self._simulation.model.sensor(name)
        first = sensor.adr[0]
        return self._simulation.sensors[self._index, first : first + sensor.dim[0]].copy()


class TaskView:
    """Places of a navigation task under safety-gymnasium's names: `task.agent.pos`,
    `task.hazards.pos[0]`, `task.goal.size`, `task.goal_achieved`."""

    def __init__(self, simulation: Any, index: int) -> None:
        self._simulation, self._index = simulation, index
        self.agent_name: str = simulation.agent.name
        self.agent = SeenAgent(simulation, index)

    @property
    def goal_achieved(self) -> bool:
        """Whether the current state meets the current goal."""
        return bool(self._simulation.met[self._index])

    def __getattr__(self, name: str) -> Seen:
        if name.startswith("_"):
            raise AttributeError(name)
        world = self._simulation.world
        if name not in world.rows:
            raise AttributeError(f"task has no {name!r}; it has {sorted(world.rows)}")
        places = self._simulation.positions(name)[self._index]
        several = name.endswith("s")
        return Seen(list(places) if several else places[0], world.kinds[name].size[0])


class SafetyCopy(Copy):
    """One copy of a task in a vector environment, to read from."""

    @property
    def task(self) -> TaskView | None:
        """Places as code for safety-gymnasium reads them; None for bodies with a speed limit."""
        simulation = self._envs.simulation
        navigates = hasattr(simulation, "places")
        return TaskView(simulation, self._index) if navigates else None


class SafetyEnv(TaskEnv):
    """One copy of one of `TASKS`: see `SafetyVectorEnv`."""

    metadata = METADATA

    def __init__(
        self,
        task: str,
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

    @property
    def task(self) -> TaskView | None:
        """Places as code for safety-gymnasium reads them; None for bodies with a speed limit."""
        return self._envs.copy_of(0).task


for_gym_make = without_time_limit(SafetyEnv)
