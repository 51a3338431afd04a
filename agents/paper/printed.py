"""The paper's printed numbers."""

from __future__ import annotations

import functools
import json
from importlib.resources import files
from typing import Any

from agents.paper.presets import registered_id


def paper_results(task: str, title: str) -> dict[str, float]:
    """The paper's numbers for an algorithm on a task, by measure; empty where it prints none.

    title: of the algorithm, as the paper prints it.
    """
    printed = _printed()["results"]
    name = registered_id(task)
    name = name.removesuffix("-v0") if name.startswith("Circle2D-") else name.split("/")[-1]
    return {
        measure: _as_meant(name, title, measure, values[title])
        for measure, values in printed.get(name, {}).items()
        if title in values
    }


@functools.cache
def _printed() -> dict[str, Any]:
    return json.loads(files("agents.paper").joinpath("printed.json").read_text())


def _as_meant(task: str, title: str, measure: str, value: float) -> float:
    """The paper prints 4.68 here; no return of this task can be positive."""
    is_misprint = (task, title, measure) == ("Circle2D-1", "TRPO-Lag", "J_R")
    return -value if is_misprint else value
