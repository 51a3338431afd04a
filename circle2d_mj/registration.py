"""The ids under which gymnasium finds the tasks."""

from __future__ import annotations

import gymnasium as gym

from circle2d_mj.config import LEVELS
from circle2d_mj.envs import MAX_EPISODE_STEPS


def register() -> None:
    """Register `Circle2D-{0..3}-v0` and `Circle2DMuJoCo-{0..3}-v0`; again, it changes nothing."""
    for level in LEVELS:
        _register(f"Circle2D-{level}-v0", "envs", "Circle2DVectorEnv", level)
        # Named by strings: MuJoCo is imported when one is made.
        _register(f"Circle2DMuJoCo-{level}-v0", "mujoco_envs", "Circle2DMuJoCoVectorEnv", level)


def _register(name: str, module: str, vector_env: str, level: int) -> None:
    if name in gym.registry:
        return
    gym.register(
        id=name,
        entry_point=f"circle2d_mj.{module}:for_gym_make",
        vector_entry_point=f"circle2d_mj.{module}:{vector_env}",
        max_episode_steps=MAX_EPISODE_STEPS,
        kwargs={"level": level},
    )
