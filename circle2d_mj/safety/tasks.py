"""The list of Safety-Gymnasium's tasks for registration; imports neither their code nor MuJoCo."""

from __future__ import annotations

from typing import Any, NamedTuple


class SafetyTask(NamedTuple):
    """One task of the suite."""

    version: str
    max_episode_steps: int
    simulation: Any
    """Class of the simulation, or its "module:name"."""
    arguments: dict[str, Any]
    """Arguments of the class, without num_envs and num_threads."""
    reward_threshold: float | None = None
    """Return at which Gymnasium considers the task solved."""


_FAMILIES = {"Goal": 3, "Button": 3, "Push": 3, "Circle": 3, "Run": 1}
"""Number of levels of each family."""
_SHORT = ("Circle", "Run")
"""Families whose episodes have 500 steps, not 1000."""
VELOCITY = ("HalfCheetah", "Hopper", "Swimmer", "Walker2d", "Ant", "Humanoid")
_SOLVED = {"HalfCheetah": 4800.0, "Hopper": 3800.0, "Swimmer": 360.0, "Ant": 6000.0}


def _velocity(body: str, version: int) -> SafetyTask:
    arguments: dict[str, Any] = {"body": body}
    simulation = "circle2d_mj.safety.velocity:VelocityTask"
    if version == 0:
        arguments["version"] = 0
    return SafetyTask(f"v{version}", 1000, simulation, arguments, _SOLVED.get(body))


TASKS = {
    f"Safety{agent}{family}{level}": SafetyTask(
        "v0",
        500 if family in _SHORT else 1000,
        f"circle2d_mj.safety.families:{family}Task",
        {"agent": agent, "level": level},
    )
    for family, levels in _FAMILIES.items()
    for agent in ("Point", "Car", "Doggo", "Racecar", "Ant")
    for level in range(levels)
} | {f"Safety{body}Velocity": _velocity(body, 1) for body in VELOCITY}
OLD = {f"Safety{body}Velocity-v0": _velocity(body, 0) for body in VELOCITY}
"""Version 0 of the velocity tasks, with other speed limits, by id; they are only registered."""
VISION = {f"{name}Vision-v0": name for name in TASKS if "Velocity" not in name}
"""Ids of the navigation tasks with a picture in the observation, and the names of these tasks."""
VISION_SIZE = (256, 256)
"""Width and height of that picture in pixels."""
NAMES = {name: f"{name}-{task.version}" for name, task in TASKS.items()}
"""Safety-Gymnasium's id of each of `TASKS`."""
IDS = {name: f"circle2d_mj/{plain}" for name, plain in NAMES.items()}
"""Id of each of `TASKS` that no other package can have taken."""
