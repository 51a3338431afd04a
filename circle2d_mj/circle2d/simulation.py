"""Circle2D as a simulation: starts, rewards, costs and ends, for any dynamics."""

# mujoco has no stubs for what is compiled.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from circle2d_mj.circle2d import task
from circle2d_mj.circle2d.config import Circle2DConfig
from circle2d_mj.circle2d.task import Move
from circle2d_mj.core.simulation import Outcome, State
from circle2d_mj.core.streams import Streams

if TYPE_CHECKING:
    from circle2d_mj.circle2d.physics import Physics
    from circle2d_mj.circle2d.view import Circle2DView
    from circle2d_mj.render.gl import Offscreen
    from circle2d_mj.render.renderer import Renderer
    from circle2d_mj.render.window import Window


DRAWERS = ("_renderer", "_offscreen", "_window")
FRAME_SIZE = 640


class Dynamics(Protocol):
    """How actions move the agents: `Kinematic`, `Physics`, or yours."""

    @property
    def info_units(self) -> dict[str, str]:
        """Units of the numbers that `step` adds to the info, beside the cost, by name."""
        ...

    @property
    def camera(self) -> str | None:
        """Camera of frames that MuJoCo draws; None for plain pictures of the arena."""
        ...

    @property
    def observation_bounds(self) -> tuple[float, ...]:
        """Upper bounds of the observation's absolute values; one for each number."""
        ...

    @property
    def position(self) -> NDArray[np.float64]:
        """Positions of the agents: [num_envs, 2], world units."""
        ...

    def start(self, streams: Streams, index: NDArray[np.intp]) -> None:
        """Place the agents `index` at random, at rest, with numbers from their streams alone."""
        ...

    def step(self, action: NDArray[np.float64]) -> Move:
        """Move every agent by its action, [num_envs, 2]."""
        ...

    def observe(self) -> NDArray[np.float32]:
        """Return the observations: a fresh array [num_envs, len(observation_bounds)]."""
        ...

    def state_dict(self) -> State:
        """Return all that steps depend on: named arrays (copies), num_envs their first axis."""
        ...

    def load_state_dict(self, state: State) -> None:
        """Load a state."""
        ...


class Circle2D:
    """`num_envs` copies of the task: see `circle2d_mj.core.simulation.Simulation`."""

    def __init__(self, config: Circle2DConfig, num_envs: int, dynamics: Dynamics) -> None:
        self.config, self.num_envs, self.dynamics = config, num_envs, dynamics
        self.recorded_info = dynamics.info_units
        self.info_keys = ("cost", *self.recorded_info)
        bounds = np.array(dynamics.observation_bounds, dtype=np.float32)
        self.observation_space = Box(-bounds, bounds)
        self.action_space = Box(-1.0, 1.0, (2,), np.float32)
        self._renderer: Renderer | None = None
        self._offscreen: Offscreen | None = None
        self._window: Window | None = None

    @property
    def view(self) -> Circle2DView:
        """The arena from above."""
        from circle2d_mj.circle2d.view import Circle2DView

        return Circle2DView(self.config)

    def start(self, streams: Streams, index: NDArray[np.intp]) -> None:
        """Place the agents `index` at random in the start area."""
        self.dynamics.start(streams, index)

    def step(self, action: NDArray[np.float64]) -> Outcome:
        """Move all agents by their actions, [num_envs, 2]."""
        contact, more = self.dynamics.step(action)
        position = self.dynamics.position
        cost = task.cost(self.config, position, contact)
        ends = cost > 0 if self.config.reset_on_cost else np.zeros(self.num_envs, dtype=bool)
        return Outcome(task.reward(self.config, position), ends, {"cost": cost, **more})

    def observe(self) -> NDArray[np.float32]:
        """Return the observations: [num_envs, 2 or 4] float32."""
        return self.dynamics.observe()

    def state_info(self) -> dict[str, NDArray[np.float64]]:
        """Return nothing: the observation holds the positions."""
        return {}

    def state_dict(self) -> State:
        """Return all that steps depend on."""
        return self.dynamics.state_dict()

    def load_state_dict(self, state: State) -> None:
        """Load a state."""
        self.dynamics.load_state_dict(state)

    def frame(self, index: int) -> NDArray[np.uint8]:
        """Draw the agent `index` in its arena: [640, 640, 3]."""
        physics: Any = self.dynamics
        if physics.camera is not None:
            if self._offscreen is None:
                from circle2d_mj.render.gl import Offscreen

                self._offscreen = Offscreen(physics.model, FRAME_SIZE, forces=True)
            return self._offscreen.draw(
                physics.data(index), physics.model.camera(physics.camera).id
            )
        if self._renderer is None:
            from circle2d_mj.render.renderer import Renderer

            self._renderer = Renderer(self.config)
        return self._renderer.frame(self.dynamics.position[index])

    def show(self, index: int) -> None:
        """Show the agent `index` in MuJoCo's viewer."""
        physics = self._physics
        if self._window is None:
            from circle2d_mj.render.window import Window

            self._window = Window(physics.model, physics.step_seconds)
        if physics is not self.dynamics:
            physics.place(np.array([0]), self.dynamics.position[[index]])
        self._window.show(physics.data(index if physics is self.dynamics else 0))

    @functools.cached_property
    def _physics(self) -> Physics:
        """The dynamics where they are MuJoCo's, else a ball to show."""
        from circle2d_mj.circle2d.physics import Physics

        return self.dynamics if isinstance(self.dynamics, Physics) else Physics(self.config, 1)

    def close(self) -> None:
        """Close what `frame` and `show` opened."""
        for name in DRAWERS:
            if (drawer := getattr(self, name)) is not None:
                drawer.close()
            setattr(self, name, None)

    def __getstate__(self) -> dict[str, Any]:
        # Renderers and windows cannot be copied.
        return self.__dict__ | dict.fromkeys(DRAWERS)
