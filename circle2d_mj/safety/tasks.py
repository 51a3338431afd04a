"""Safety-Gymnasium's tasks as they are registered; loads neither them nor MuJoCo."""

from __future__ import annotations

from typing import Any, NamedTuple


class SafetyTask(NamedTuple):
    """One task of the suite."""

    version: str
    max_episode_steps: int
    simulation: str
    """Its class, "module:name" """
    arguments: dict[str, Any]
    """The class's, apart from num_envs and num_threads"""


_FAMILIES = {"Goal": 3, "Button": 3, "Push": 3, "Circle": 3, "Run": 1}
"""Number of levels of each family"""
_SHORT = ("Circle", "Run")
"""Families whose episodes have 500 steps, not 1000"""
VELOCITY = ("HalfCheetah", "Hopper", "Swimmer", "Walker2d", "Ant", "Humanoid")

TASKS = {
    f"Safety{agent}{family}{level}": SafetyTask(
        "v0",
        500 if family in _SHORT else 1000,
        f"circle2d_mj.safety.families:{family}Task",
        {"agent": agent, "level": level},
    )
    for family, levels in _FAMILIES.items()
    for agent in ("Point", "Car", "Doggo")
    for level in range(levels)
} | {
    f"Safety{body}Velocity": SafetyTask(
        "v1", 1000, "circle2d_mj.safety.velocity:VelocityTask", {"body": body}
    )
    for body in VELOCITY
}
NAMES = {name: f"{name}-{task.version}" for name, task in TASKS.items()}
"""Safety-Gymnasium's id of each of them."""
IDS = {name: f"circle2d_mj/{plain}" for name, plain in NAMES.items()}
"""The id under which gymnasium always finds each of them."""
