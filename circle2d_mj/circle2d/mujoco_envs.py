"""Circle2D with MuJoCo's physics, as gymnasium environments."""

from __future__ import annotations

from functools import partial
from typing import Any

from gymnasium.vector import AutoresetMode

from circle2d_mj.circle2d.config import Circle2DConfig
from circle2d_mj.circle2d.envs import MAX_EPISODE_STEPS, Circle2DEnv, Circle2DVectorEnv
from circle2d_mj.circle2d.physics import Physics
from circle2d_mj.circle2d.scene import Actuation
from circle2d_mj.core.single_env import without_time_limit


class Circle2DMuJoCoVectorEnv(Circle2DVectorEnv):
    """Many Circle2D tasks with a ball that has inertia, and a region made of contact geometry.

    As `Circle2DVectorEnv`, except for

    | | shape | meaning |
    | --- | --- | --- |
    | observation | [num_envs, 4] float32 | the position as there; the velocity over 0.11 R a step |
    | action | [num_envs, 2] | target velocity, or thrust, over the greatest; clipped to [-1, 1] |
    | `info["cost"]` | [num_envs] float64 | level 0: 1.0 where the ball touched the region in the step, 1 to 3: where its centre ended inside |
    | `info["contact_force"]` | [num_envs] float64 | level 0: the region's greatest force on the ball |
    | `info["penetration"]` | [num_envs] float64 | world units: overlap on level 0, else distance from the centre to free space |

    actuation: "velocity" or "force" (see `scene`); num_threads: threads that step the
    environments, with the same results for any number. A step takes 0.1 s: ten of 0.01 s.
    """  # noqa: E501

    def __init__(
        self,
        num_envs: int = 1,
        *,
        config: Circle2DConfig | None = None,
        actuation: Actuation = "velocity",
        num_threads: int = 1,
        max_episode_steps: int | None = MAX_EPISODE_STEPS,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        **parameters: Any,
    ) -> None:
        super().__init__(
            num_envs,
            config=config,
            dynamics=partial(Physics, actuation=actuation, num_threads=num_threads),
            max_episode_steps=max_episode_steps,
            autoreset_mode=autoreset_mode,
            render_mode=render_mode,
            **parameters,
        )


class Circle2DMuJoCoEnv(Circle2DEnv):
    """One Circle2D task with physics: `Circle2DMuJoCoVectorEnv` without its first axis."""

    def __init__(
        self,
        config: Circle2DConfig | None = None,
        *,
        actuation: Actuation = "velocity",
        num_threads: int = 1,
        max_episode_steps: int | None = MAX_EPISODE_STEPS,
        render_mode: str | None = None,
        **parameters: Any,
    ) -> None:
        super().__init__(
            config,
            dynamics=partial(Physics, actuation=actuation, num_threads=num_threads),
            max_episode_steps=max_episode_steps,
            render_mode=render_mode,
            **parameters,
        )


for_gym_make = without_time_limit(Circle2DMuJoCoEnv)
