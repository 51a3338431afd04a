"""Circle2D as gymnasium environments: kinematic, and with MuJoCo's physics."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from circle2d_mj.circle2d.config import Circle2DConfig
from circle2d_mj.circle2d.kinematic import Kinematic
from circle2d_mj.circle2d.simulation import Circle2D, Dynamics
from circle2d_mj.core.simulation import positive_integer
from circle2d_mj.core.single_env import TaskEnv, without_time_limit
from circle2d_mj.core.vector_env import TaskVectorEnv
from circle2d_mj.render.gl import render_modes

MAX_EPISODE_STEPS = 50
METADATA: dict[str, Any] = {"render_modes": render_modes(), "render_fps": 10}


class Circle2DVectorEnv(TaskVectorEnv):
    """Many Circle2D tasks stepped together in numpy.

    | | shape | meaning |
    | --- | --- | --- |
    | observation | [num_envs, 2] float32 | x and y over the arena's half-width, in [-1, 1] |
    | action | [num_envs, 2] | step on x and y over 0.11 R, clipped to [-1, 1] |
    | reward | [num_envs] float64 | minus the distance to the optimum over the half-diagonal |
    | `info["cost"]` | [num_envs] float64 | 1.0 where the move led into the cost region, else 0.0 |

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
        """Positions of the agents, world units: [num_envs, 2], a copy."""
        return self._dynamics.position.copy()


class Circle2DEnv(TaskEnv):
    """One Circle2D task: see `Circle2DVectorEnv` for observation, action, reward and cost.

    `info["cost"]` is a float, on every step and from `reset`. The task is given as a
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
        """Position of the agent, world units: [2], a copy."""
        return self._circle2d.position[0]


for_gym_make = without_time_limit(Circle2DEnv)
