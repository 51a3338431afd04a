"""The ids under which gymnasium finds the tasks."""

from __future__ import annotations

import gymnasium as gym

from circle2d_mj.config import LEVELS
from circle2d_mj.envs import MAX_EPISODE_STEPS


def register() -> None:
    """Register `Circle2D-{0..3}-v0`; calling it again changes nothing."""
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
