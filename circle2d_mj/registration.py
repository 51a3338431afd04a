"""Ids of the tasks, and their registration with Gymnasium."""

from __future__ import annotations

from typing import Any

import gymnasium as gym

from circle2d_mj.circle2d.config import LEVELS
from circle2d_mj.circle2d.envs import MAX_EPISODE_STEPS
from circle2d_mj.safety import tasks as safety

KINEMATIC = {level: f"Circle2D-{level}-v0" for level in LEVELS}
PHYSICS = {level: f"Circle2DMuJoCo-{level}-v0" for level in LEVELS}
CIRCLE2D = (*KINEMATIC.values(), *PHYSICS.values())
"""Ids of the Circle2D tasks, by level and all together."""
SAFETY = tuple(safety.IDS.values())
"""Ids of Safety-Gymnasium's tasks that no other package can have taken."""


def register() -> None:
    """Register `CIRCLE2D` and `SAFETY` with Gymnasium; calling it again changes nothing.

    The Safety tasks also get Safety-Gymnasium's own ids, such as `SafetyPointGoal1-v0`, unless
    another package has registered them.
    """
    for level in LEVELS:
        kinematic, physics = "circle2d.envs:Circle2D", "circle2d.mujoco_envs:Circle2DMuJoCo"
        add(KINEMATIC[level], kinematic, MAX_EPISODE_STEPS, level=level)
        add(PHYSICS[level], physics, MAX_EPISODE_STEPS, level=level)
    for name, task in safety.TASKS.items():
        add_safety(safety.NAMES[name], name, task)
    for name, task in safety.OLD.items():
        add_safety(name, name, task)
    for id, name in safety.VISION.items():
        add_safety(id, name, safety.TASKS[name], vision_size=safety.VISION_SIZE)


def add_safety(
    plain: str, of_env: str | safety.SafetyTask, task: safety.SafetyTask, **parameters: Any
) -> None:
    """Register a Safety task under `circle2d_mj/...`, and under the plain id if it is free."""
    for name in (f"circle2d_mj/{plain}", plain):
        steps, solved = task.max_episode_steps, task.reward_threshold
        add(name, "safety.envs:Safety", steps, reward_threshold=solved, task=of_env, **parameters)


def add(
    name: str,
    env: str,
    max_episode_steps: int,
    reward_threshold: float | None = None,
    **parameters: Any,
) -> None:
    """Register a task with Gymnasium, unless its name is taken. env: "module:class" in this
    package, without the class's suffix VectorEnv."""
    if name in gym.registry:
        return
    # Entry points are names, so that MuJoCo is imported only when an environment needs it.
    gym.register(
        id=name,
        entry_point=f"circle2d_mj.{env.partition(':')[0]}:for_gym_make",
        vector_entry_point=f"circle2d_mj.{env}VectorEnv",
        max_episode_steps=max_episode_steps,
        reward_threshold=reward_threshold,
        kwargs=parameters,
    )
