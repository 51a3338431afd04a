"""The ids under which gymnasium finds the tasks."""

from __future__ import annotations

from typing import Any

import gymnasium as gym

from circle2d_mj.circle2d.config import LEVELS
from circle2d_mj.circle2d.envs import MAX_EPISODE_STEPS

KINEMATIC = {level: f"Circle2D-{level}-v0" for level in LEVELS}
PHYSICS = {level: f"Circle2DMuJoCo-{level}-v0" for level in LEVELS}
CIRCLE2D = (*KINEMATIC.values(), *PHYSICS.values())
"""Ids of the Circle2D tasks, by level and all together."""

# Version and steps an episode of the tasks in `safety.envs.TASKS`, which this module must
# not import, since that loads MuJoCo.
_SAFETY_TASKS = {
    "SafetyPointCircle1": ("v0", 500),
    "SafetyPointGoal1": ("v0", 1000),
    "SafetyHopperVelocity": ("v1", 1000),
}


def register() -> None:
    """Register `Circle2D-{0..3}-v0`, `Circle2DMuJoCo-{0..3}-v0` and the tasks of Safety-Gymnasium,
    the latter as `circle2d_mj/...`; calling it again changes nothing."""
    for level in LEVELS:
        _register(KINEMATIC[level], "circle2d.envs:Circle2DVectorEnv", level=level)
        _register(PHYSICS[level], "circle2d.mujoco_envs:Circle2DMuJoCoVectorEnv", level=level)
    for task, (version, steps) in _SAFETY_TASKS.items():
        name = f"circle2d_mj/{task}-{version}"
        _register(name, "safety.envs:SafetyVectorEnv", steps, task=task)


def _register(
    name: str, vector_env: str, steps: int = MAX_EPISODE_STEPS, **parameters: Any
) -> None:
    if name in gym.registry:
        return
    module, _, _ = vector_env.partition(":")
    # By name, so that MuJoCo is imported only when an environment needs it.
    gym.register(
        id=name,
        entry_point=f"circle2d_mj.{module}:for_gym_make",
        vector_entry_point=f"circle2d_mj.{vector_env}",
        max_episode_steps=steps,
        kwargs=parameters,
    )
