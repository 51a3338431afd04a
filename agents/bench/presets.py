"""The hyper-parameters that the paper used on Circle2D."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from agents.algorithms import algorithm


def preset(name: str, task: str) -> Any:
    """The hyper-parameters of an algorithm for a task: on Circle2D the paper's.

    For any other task the defaults of the algorithm's config. Raises UserError for an unknown
    algorithm.
    """
    config = algorithm(name).config()
    if task.startswith("Circle2D"):
        return replace(
            config,
            cost_limit=5.0,  # table Circle2DResults, caption
            time_limit="terminal",  # inferred from the printed results, not printed itself
        )
    return config
