"""Circle2D: the simulation of many copies, for any dynamics, and its Gymnasium environments."""

# mujoco has no type stubs for its compiled modules.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.spaces import Box, Space
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from circle2d_mj.circle2d import task
from circle2d_mj.circle2d.config import Circle2DConfig
from circle2d_mj.circle2d.task import Dynamics, Kinematic
from circle2d_mj.core.envs import TaskEnv, TaskVectorEnv, render_modes, without_time_limit
from circle2d_mj.core.simulation import Outcome, positive_integer

if TYPE_CHECKING:
    from circle2d_mj.circle2d.physics import Physics
    from circle2d_mj.circle2d.view import Circle2DView


MAX_EPISODE_STEPS = 50
METADATA: dict[str, Any] = {"render_modes": render_modes(), "render_fps": 10}
FRAME_SIZE = 640


class Circle2D:
    """`num_envs` copies of the task: see `circle2d_mj.core.simulation.Simulation`."""

    def __init__(self, config: Circle2DConfig, num_envs: int, dynamics: Dynamics) -> None:
        self.config, self.num_envs, self.dynamics = config, num_envs, dynamics
        self.recorded_info = dynamics.info_units
        self.moving: NDArray[np.intp] | None = None
        self.info_keys = ("cost", *self.recorded_info, *self.state_info())
        bounds = np.array(dynamics.observation_bounds, dtype=np.float32)
        self.observation_space: Space[Any] = Box(-bounds, bounds)
        self.action_space: Box = Box(-1.0, 1.0, (2,), np.float32)
        # The dynamics hold the whole state.
        self.start, self.observe = dynamics.start, dynamics.observe
        self.state_dict, self.load_state_dict = dynamics.state_dict, dynamics.load_state_dict
        self._offscreen: Any = None
        self._window: Any = None

    @property
    def view(self) -> Circle2DView:
        """View of the arena from above."""
        from circle2d_mj.circle2d.view import Circle2DView

        return Circle2DView(self.config)

    def step(self, action: NDArray[np.float64]) -> Outcome:
        """Move all agents with their actions, [num_envs, 2]."""
        contact, more = self.dynamics.step(action)
        ended = self.dynamics.position
        costs = task.cost(self.config, ended, contact)
        ends = costs > 0 if self.config.reset_on_cost else np.zeros(self.num_envs, dtype=bool)
        return Outcome(task.reward(self.config, ended), ends, {"cost": costs, **more})

    def state_info(self) -> dict[str, NDArray[np.float64]]:
        """Return the numbers of the info with which the dynamics describe the state."""
        tell = getattr(self.dynamics, "state_info", None)
        return tell() if tell else {}

    def frame(self, index: int) -> NDArray[np.uint8]:
        """Draw agent `index` in its arena, with physics by OpenGL: [640, 640, 3]."""
        dynamics: Any = self.dynamics
        if dynamics.camera is None:
            from circle2d_mj.render import canvas

            place = dynamics.position[index]
            return canvas.with_agent(_arena(self.config), self.view.extent, place)
        if self._offscreen is None:
            from circle2d_mj.render.gl import Offscreen

            self._offscreen = Offscreen(dynamics.model, FRAME_SIZE, FRAME_SIZE, True)
        camera = dynamics.model.camera(dynamics.camera).id
        return self._offscreen.draw(dynamics.data(index), camera)

    def show(self, index: int) -> None:
        """Show agent `index` in MuJoCo's viewer."""
        physics = self._physics
        if self._window is None:
            from circle2d_mj.render.gl import Window

            self._window = Window(physics.model, physics.step_seconds)
        if physics is not self.dynamics:
            physics.place(np.array([0]), self.dynamics.position[[index]])
        self._window.show(physics.data(index if physics is self.dynamics else 0))

    @cached_property
    def _physics(self) -> Physics:
        """The dynamics if they are MuJoCo's, else a ball for the viewer."""
        from circle2d_mj.circle2d.physics import Physics

        return self.dynamics if isinstance(self.dynamics, Physics) else Physics(self.config, 1)

    def close(self) -> None:
        """Close what `frame` and `show` opened."""
        for drawer in (self._offscreen, self._window):
            if drawer is not None:
                drawer.close()
        self._offscreen = self._window = None

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_offscreen": None, "_window": None}  # cannot be copied


@lru_cache(maxsize=1)  # outside of the copies, whose pickles would hold it
def _arena(config: Circle2DConfig) -> NDArray[np.uint8]:
    """Paint the arena without agents: [640, 640, 3]."""
    from circle2d_mj.circle2d.view import Circle2DView

    view = Circle2DView(config)
    return view.overlay(view.background(FRAME_SIZE))


class Circle2DVectorEnv(TaskVectorEnv):
    """Many Circle2D tasks stepped together in NumPy.

    | | shape | meaning |
    | --- | --- | --- |
    | observation | [num_envs, 2] float32 | x and y over the arena's half-width, in [-1, 1] |
    | action | [num_envs, 2] | step on x and y over 0.11 R (`step_length`), clipped to [-1, 1] |
    | reward | [num_envs] float64 | minus the distance to the optimum over the half-diagonal |
    | `info["cost"]` | [num_envs] float64 | 1.0 if the move led into the cost region, else 0.0 |

    The task is given as a `Circle2DConfig` or by its parameters: `Circle2DVectorEnv(8, level=2)`.
    dynamics: class or function that makes the dynamics from the configuration and num_envs. Seeds,
    autoreset and errors: see `TaskVectorEnv`.
    """

    metadata = METADATA

    def __init__(
        self,
        num_envs: int = 1,
        *,
        config: Circle2DConfig | None = None,
        dynamics: Callable[[Circle2DConfig, int], Dynamics] = Kinematic,
        max_episode_steps: int | None = MAX_EPISODE_STEPS,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        **parameters: Any,
    ) -> None:
        self.config = Circle2DConfig.of(config, parameters)
        num_envs = positive_integer("num_envs", num_envs)
        self._dynamics = dynamics(self.config, num_envs)
        super().__init__(
            Circle2D(self.config, num_envs, self._dynamics),
            max_episode_steps=max_episode_steps,
            autoreset_mode=autoreset_mode,
            render_mode=render_mode,
        )

    @property
    def position(self) -> NDArray[np.float64]:
        """Positions of the agents in world units: [num_envs, 2], a copy."""
        return self._dynamics.position.copy()


class Circle2DEnv(TaskEnv):
    """One Circle2D task: see `Circle2DVectorEnv` for observation, action, reward and cost.

    `info["cost"]` is a float, from every step and from `reset`. The task is given as a
    `Circle2DConfig` or by its parameters.
    """

    metadata = METADATA

    def __init__(
        self,
        config: Circle2DConfig | None = None,
        *,
        dynamics: Callable[[Circle2DConfig, int], Dynamics] = Kinematic,
        max_episode_steps: int | None = MAX_EPISODE_STEPS,
        render_mode: str | None = None,
        **parameters: Any,
    ) -> None:
        self._circle2d = Circle2DVectorEnv(
            config=config,
            dynamics=dynamics,
            max_episode_steps=max_episode_steps,
            autoreset_mode=AutoresetMode.DISABLED,
            render_mode=render_mode,
            **parameters,
        )
        super().__init__(self._circle2d)
        self.config = self._circle2d.config

    @property
    def position(self) -> NDArray[np.float64]:
        """Position of the agent in world units: [2], a copy."""
        return self._circle2d.position[0]


for_gym_make = without_time_limit(Circle2DEnv)
