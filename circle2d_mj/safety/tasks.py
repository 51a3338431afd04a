"""The Safety tasks as they are registered; loads neither them nor MuJoCo."""

from __future__ import annotations

from typing import NamedTuple


class SafetyTask(NamedTuple):
    """One of the paper's other three tasks."""

    version: str
    max_episode_steps: int
    simulation: str
    """Its class, "module:name"; made from num_envs and num_threads."""


_HERE = "circle2d_mj.safety"
TASKS = {
    "SafetyPointCircle1": SafetyTask("v0", 500, f"{_HERE}.circle:SafetyPointCircle"),
    "SafetyPointGoal1": SafetyTask("v0", 1000, f"{_HERE}.goal:SafetyPointGoal"),
    "SafetyHopperVelocity": SafetyTask("v1", 1000, f"{_HERE}.hopper:SafetyHopperVelocity"),
}
IDS = {name: f"circle2d_mj/{name}-{task.version}" for name, task in TASKS.items()}
"""The id under which gymnasium finds each of them."""
