"""The hyper-parameters that the paper used, by task."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from inspect import get_annotations
from typing import Any

from agents.algorithms import RESERVED, algorithm
from agents.errors import OTHER_NAMES, UserError, nearest
from circle2d_mj.circle2d.config import Circle2DConfig
from circle2d_mj.registration import CIRCLE2D, KINEMATIC, SAFETY
from circle2d_mj.safety.tasks import NAMES

PAPER_ALGORITHMS = ("trpo-lag", "cpo", "sac-lag", "sac-lb", "wcsac")
"""The algorithms that the paper compares, in the order of its tables."""
_SAFETY = ("SafetyPointCircle1-v0", "SafetyPointGoal1-v0", "SafetyHopperVelocity-v1")
PAPER_STEPS = dict.fromkeys(KINEMATIC.values(), 1_000_000)
PAPER_STEPS |= {f"circle2d_mj/{name}": 10_000_000 for name in _SAFETY}
"""Environment steps of a run on each task of the paper: tables HP_*, total timesteps."""
STEPS = 1_000_000
"""Those of a run on any other task."""
PAPER_SEEDS = 3
"""Runs of an algorithm on a task. Tables Circle2DResults and SafetyGymnasiumResults, captions."""


def registered_id(task: str) -> str:
    """The one id of a task, which has others: "module:id", and Safety-Gymnasium's own."""
    name = task.rpartition(":")[2]
    return f"circle2d_mj/{name}" if name in NAMES.values() else name


def is_circle2d(task: str) -> bool:
    """Whether a task is one of Circle2D, of either mode."""
    return registered_id(task) in CIRCLE2D


def length_scale(task: str) -> float | tuple[float, ...]:
    """`input_scale` that turns the observations of a Circle2D task back into units of length, 15;
    with physics its velocities into such units a step, 1.1."""
    config = Circle2DConfig()
    if registered_id(task) in KINEMATIC.values():
        return config.arena
    return (config.arena, config.arena, config.full_step, config.full_step)


def preset(name: str, task: str) -> Any:
    """The hyper-parameters of an algorithm for a task: on the paper's tasks the paper's.

    An algorithm that the paper does not have gets those of its family, one whose config is a
    subclass of SAC-LB-Streak's those of SAC-LB-Streak, which sees Circle2D in units of length. A
    default that a subclass changes comes before them. For any other task the defaults of the
    algorithm's config. Raises UserError for an unknown algorithm.
    """
    config = algorithm(name).config()
    kind = type(config)
    printed = _printed(config, registered_id(task))
    return replace(config, **{k: v for k, v in printed.items() if not _redefines(kind, k)})


def _printed(config: Any, task: str) -> dict[str, Any]:
    """Hyper-parameters that the paper prints for a task and that are not the defaults."""
    if is_circle2d(task):
        # Table Circle2DResults, caption; for the time limit, on-policy the default: `unprinted`.
        found = {"cost_limit": 5.0} if hasattr(config, "cost_limit") else {}
        found |= {"time_limit": "terminal"} if is_off_policy(config) else {}
        in_lengths = getattr(config, "in_lengths", False)
        return found | ({"input_scale": length_scale(task)} if in_lengths else {})
    if task in SAFETY:
        # Table HP_SafetyGymnasium, for the whole suite; the cost limit, 25, is the default.
        if is_off_policy(config):
            return {"random_steps": 50_000, "replay_size": 500_000}
        if "PointCircle1" in task and hasattr(config, "episodes"):
            return {"episodes": 20}
    return {}


def _redefines(kind: type, name: str) -> bool:
    """Whether a class has a default of its own for a hyper-parameter that it inherits."""
    return sum(name in get_annotations(base) for base in kind.__mro__) > 1


def preset_with(name: str, task: str, given: Mapping[str, Any]) -> Any:
    """The preset with the given values instead of its own. Raises UserError, with the name that was
    probably meant, for a hyper-parameter that the algorithm does not have."""
    config = preset(name, task)
    names = [field.name for field in fields(config)]
    for other in given:
        if other not in names:
            meant = OTHER_NAMES.get(other, other)
            others = [name for name in (*names, *RESERVED) if name != other]
            hint = nearest(meant, others, f"it has {', '.join(names)}")
            raise UserError(f"{name} has no hyper-parameter {other!r}: {hint}")
    return replace(config, **{k: tuple(v) if isinstance(v, list) else v for k, v in given.items()})


def is_off_policy(config: Any) -> bool:
    """Whether an algorithm of that config learns from a replay."""
    return hasattr(config, "replay_size")


def usual_steps(task: str) -> int:
    """Environment steps of a run: the paper's on its tasks, `STEPS` on any other."""
    return PAPER_STEPS.get(registered_id(task), STEPS)
