"""The hyper-parameters that the paper used on Circle2D."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from agents.algorithms import algorithm
from agents.updates.sac import SACConfig


def preset(name: str, task: str) -> Any:
    """The hyper-parameters of an algorithm for a task: on Circle2D the paper's.

    For any other task the defaults of the algorithm's config. Raises UserError for an unknown
    algorithm.
    """
    config = algorithm(name).config()
    if not task.startswith("Circle2D"):
        return config
    config = replace(config, cost_limit=5.0)  # table Circle2DResults, caption
    if isinstance(config, SACConfig):
        # Inferred from the printed results, not printed itself; on-policy methods bootstrap.
        config = replace(config, time_limit="terminal")
    return config
