"""The ids under which gymnasium finds the tasks."""

from __future__ import annotations

import gymnasium as gym

from circle2d_mj.config import LEVELS
from circle2d_mj.envs import MAX_EPISODE_STEPS

# Version and steps an episode of the tasks in `safety_tasks.envs.TASKS`, which this module must
# not import, since that loads MuJoCo.
_SAFETY_TASKS = {
    "SafetyPointCircle1": ("v0", 500),
    "SafetyPointGoal1": ("v0", 1000),
    "SafetyHopperVelocity": ("v1", 1000),
}


def register() -> None:
    """Register `Circle2D-{0..3}-v0` and the tasks of Safety-Gymnasium, the latter as
    `circle2d_mj/...`; calling it again changes nothing."""
    for level in LEVELS:
        name = f"Circle2D-{level}-v0"
        if name in gym.registry:
            continue
        gym.register(
            id=name,
            entry_point="circle2d_mj.envs:for_gym_make",
            vector_entry_point="circle2d_mj.envs:Circle2DVectorEnv",
            max_episode_steps=MAX_EPISODE_STEPS,
            kwargs={"level": level},
        )
    for task, (version, steps) in _SAFETY_TASKS.items():
        name = f"circle2d_mj/{task}-{version}"
        if name in gym.registry:
            continue
        gym.register(
            id=name,
            entry_point="circle2d_mj.safety_tasks.envs:for_gym_make",
            vector_entry_point="circle2d_mj.safety_tasks.envs:SafetyVectorEnv",
            max_episode_steps=steps,
            kwargs={"task": task},
        )
