"""Circle2D with MuJoCo's physics, as Gymnasium environments."""

from __future__ import annotations

from dataclasses import fields
from functools import partial
from typing import Any

from gymnasium.vector import AutoresetMode

from circle2d_mj.circle2d.config import Camera, Circle2DConfig, check_names
from circle2d_mj.circle2d.envs import MAX_EPISODE_STEPS, Circle2DEnv, Circle2DVectorEnv
from circle2d_mj.circle2d.physics import Physics
from circle2d_mj.circle2d.physics_config import PhysicsConfig
from circle2d_mj.core.envs import without_time_limit


class Circle2DMuJoCoVectorEnv(Circle2DVectorEnv):
    """Many Circle2D tasks with a ball that has inertia, and a region made of contact geometry.

    Like `Circle2DVectorEnv`, except for

    | | shape | meaning |
    | --- | --- | --- |
    | observation | [num_envs, 4] float32 | the position as there; the velocity over 0.11 R per step |
    | action | [num_envs, 2] | target velocity, or thrust, over its maximum; clipped to [-1, 1] |
    | `info["cost"]` | [num_envs] float64 | 1.0 if the ball touched a region that pushes, or its centre ended in a region that does not push; with `force_limit`, 1.0 if the force was above it |
    | `info["contact_force"]` | [num_envs] float64 | N; greatest force of the region on the ball during the step |
    | `info["penetration"]` | [num_envs] float64 | m; greatest overlap of ball and region during the step; if the region does not push, distance from the ball's centre to free space |

    Parameters that `randomize` draws are in the info by name, [num_envs] float64.

    Parameters: the fields of `Circle2DConfig` and `PhysicsConfig`. num_threads: threads that step
    the environments, with the same results for any number. camera: "top", "side" or "follow", of
    frames that MuJoCo draws, with shadows and the region's forces as arrows; None for plain
    pictures of the arena, which need no OpenGL.
    """  # noqa: E501

    def __init__(
        self,
        num_envs: int = 1,
        *,
        config: Circle2DConfig | None = None,
        max_episode_steps: int | None = MAX_EPISODE_STEPS,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        num_threads: int = 1,
        camera: Camera | None = None,
        **parameters: Any,
    ) -> None:
        super().__init__(
            num_envs,
            config=config,
            max_episode_steps=max_episode_steps,
            autoreset_mode=autoreset_mode,
            render_mode=render_mode,
            **with_physics(config, parameters, num_threads, camera),
        )


class Circle2DMuJoCoEnv(Circle2DEnv):
    """One Circle2D task with physics: `Circle2DMuJoCoVectorEnv` without its first axis."""

    def __init__(
        self,
        config: Circle2DConfig | None = None,
        *,
        max_episode_steps: int | None = MAX_EPISODE_STEPS,
        render_mode: str | None = None,
        num_threads: int = 1,
        camera: Camera | None = None,
        **parameters: Any,
    ) -> None:
        super().__init__(
            config,
            max_episode_steps=max_episode_steps,
            render_mode=render_mode,
            **with_physics(config, parameters, num_threads, camera),
        )


def with_physics(
    config: Circle2DConfig | None,
    parameters: dict[str, Any],
    num_threads: int,
    camera: Camera | None,
) -> dict[str, Any]:
    """Return the parameters of the task, and `dynamics` made from the parameters of the physics.

    A given `contact` sets infeasible_region_penetratable, unless that is given. Raises like
    `PhysicsConfig`, and TypeError for an unknown name.
    """
    of_task, of_physics = (
        [f.name for f in fields(kind)] for kind in (Circle2DConfig, PhysicsConfig)
    )
    check_names(parameters, [*of_task, *of_physics])
    physics = PhysicsConfig(**{k: v for k, v in parameters.items() if k in of_physics})
    task = {k: v for k, v in parameters.items() if k in of_task}
    if physics.contact is not None and config is None:
        task.setdefault("infeasible_region_penetratable", physics.contact != "rigid")
    how = {"physics": physics, "num_threads": num_threads, "camera": camera}
    return {**task, "dynamics": partial(Physics, **how)}


for_gym_make = without_time_limit(Circle2DMuJoCoEnv)
