"""The hyper-parameters that the paper used, by task."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from agents.algorithms import algorithm
from agents.updates.sac import SACConfig
from circle2d_mj.config import LEVELS

_SAFETY = ("SafetyPointCircle1-v0", "SafetyPointGoal1-v0", "SafetyHopperVelocity-v1")
PAPER_STEPS = {f"Circle2D-{level}-v0": 1_000_000 for level in LEVELS} | {
    f"circle2d_mj/{name}": 10_000_000 for name in _SAFETY
}
"""Environment steps of a run, by the id of every task of the paper. Tables HP_Circle2D and
HP_SafetyGymnasium, total timesteps."""
PAPER_SEEDS = 3
"""Runs of an algorithm on a task. Tables Circle2DResults and SafetyGymnasiumResults, captions."""


def preset(name: str, task: str) -> Any:
    """The hyper-parameters of an algorithm for a task: on the paper's tasks the paper's.

    For any other task the defaults of the algorithm's config. Raises UserError for an unknown
    algorithm.
    """
    config = algorithm(name).config()
    off_policy = isinstance(config, SACConfig)
    task = task.rpartition(":")[2]  # "module:id" names the task that "id" does
    if task.startswith("Circle2D"):
        config = replace(config, cost_limit=5.0)  # table Circle2DResults, caption
        if off_policy:
            # Inferred from the printed results, not printed itself; on-policy methods bootstrap.
            config = replace(config, time_limit="terminal")
    elif task.startswith("circle2d_mj/Safety"):
        # Table HP_SafetyGymnasium; the cost limit, 25, is the default.
        if off_policy:
            config = replace(config, random_steps=50_000, replay_size=500_000)
        elif task.startswith("circle2d_mj/SafetyPointCircle1"):
            config = replace(config, episodes=20)
    return config
