"""The hyper-parameters that the paper used, by task."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from inspect import get_annotations
from typing import Any, NamedTuple

from agents.algorithms import RESERVED, algorithm
from agents.errors import OTHER_NAMES, UserError, nearest
from circle2d_mj.circle2d.config import Circle2DConfig
from circle2d_mj.registration import CIRCLE2D, KINEMATIC

PAPER_ALGORITHMS = ("trpo-lag", "cpo", "sac-lag", "sac-lb", "wcsac")
"""The algorithms that the paper compares, in the order of its tables."""
_SAFETY = ("SafetyPointCircle1-v0", "SafetyPointGoal1-v0", "SafetyHopperVelocity-v1")
PAPER_STEPS = dict.fromkeys(KINEMATIC.values(), 1_000_000) | {
    f"circle2d_mj/{name}": 10_000_000 for name in _SAFETY
}
"""Environment steps of a run, by the id of every task of the paper. Tables HP_Circle2D and
HP_SafetyGymnasium, total timesteps."""
STEPS = 1_000_000
"""Those of a run on any other task."""
PAPER_SEEDS = 3
"""Runs of an algorithm on a task. Tables Circle2DResults and SafetyGymnasiumResults, captions."""


def registered_id(task: str) -> str:
    """The id of a task: "module:id" names the one that "id" does."""
    return task.rpartition(":")[2]


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
    of_task = _of_task(config, _is_off_policy(config), registered_id(task))
    return replace(config, **{of: v for of, v in of_task.items() if not _redefines(kind, of)})


def _of_task(config: Any, off_policy: bool, task: str) -> dict[str, Any]:
    """Hyper-parameters that the paper prints for a task and that are not the defaults."""
    if is_circle2d(task):
        # Table Circle2DResults, caption; for the time limit see `unprinted`: on-policy bootstraps.
        found = {"cost_limit": 5.0} if hasattr(config, "cost_limit") else {}
        found |= {"time_limit": "terminal"} if off_policy else {}
        return found | (
            {"input_scale": length_scale(task)} if getattr(config, "in_lengths", False) else {}
        )
    if task.startswith("circle2d_mj/Safety"):
        # Table HP_SafetyGymnasium; the cost limit, 25, is the default.
        if off_policy:
            return {"random_steps": 50_000, "replay_size": 500_000}
        if task.startswith("circle2d_mj/SafetyPointCircle1") and hasattr(config, "episodes"):
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
            hint = nearest(meant, [*names, *RESERVED], f"it has {', '.join(names)}")
            raise UserError(f"{name} has no hyper-parameter {other!r}: {hint}")
    return replace(config, **{k: tuple(v) if isinstance(v, list) else v for k, v in given.items()})


def _is_off_policy(config: Any) -> bool:
    return hasattr(config, "replay_size")


def usual_steps(task: str) -> int:
    """Environment steps of a run: the paper's on its tasks, `STEPS` on any other."""
    return PAPER_STEPS.get(registered_id(task), STEPS)


class Unprinted(NamedTuple):
    """A hyper-parameter that the paper does not print, and that decides how runs end."""

    field: str
    choices: dict[str, str]
    """Both, each with its meaning in words."""


MULTIPLIER = Unprinted(
    "multiplier_optimizer",
    {
        "adam": "the multiplier ascends by Adam",
        "sgd": "the multiplier ascends by the plain gradient",
    },
)
TIME_LIMIT = Unprinted(
    "time_limit",
    {
        "terminal": "the last step of an episode counts as terminal",
        "bootstrap": "values bootstrap at the time limit of an episode",
    },
)


def unprinted(name: str) -> Unprinted | None:
    """The hyper-parameter that decides and that the paper does not print; None where there is none.

    The printed step size of TRPO-Lag's multiplier fits one optimiser or the other; whether step 50
    ends an episode of Circle2D for good decides where the off-policy methods end up. What either
    choice gives beside the paper's results: results/README.md. (The multipliers of SAC-Lag and
    WCSAC ascend by Adam, as everything else of theirs does.)
    """
    if name == "trpo-lag":
        return MULTIPLIER
    off_policy = name in PAPER_ALGORITHMS and _is_off_policy(algorithm(name).config)
    return TIME_LIMIT if off_policy else None


LIBRARY = {"variance_target": "unsquared", "damping_gradient": "through"}
"""WCSAC as in a later library of the paper's group: see `WCSACConfig`."""


PARTS = {
    "streak": ("streak_weight",),
    "brown": ("random_exponent",),
    "share": ("random_share",),
    "novelty": ("novelty_bonus",),
    "horizon": ("time_limit",),
    "scale": ("input_scale",),
    "speed": ("learning_rate", "temperature_lr", "batch_size", "gradient_steps"),
}
"""The hyper-parameters that SAC-LB-Streak has on Circle2D in the place of SAC-LB's, by part."""
MARGIN = 1.5
"""How far the cost limit falls in the control that has a margin instead of the streak cost."""


def ablations(name: str, task: str) -> dict[str, Any]:
    """The preset with one thing changed, by the change's name: several for each algorithm.

    For the paper's algorithms: other choices of what the paper does not print. On Circle2D the unit
    of observations is one of them: "units" is that of length instead of the half arena. For
    SAC-LB-Streak on Circle2D: SAC-LB's values for one of its `PARTS`, and a lower cost limit in the
    place of the streak cost. Without the unit of length the bonus for new states keeps its length
    between positions; with physics it counts a place anew at every speed.
    """
    if name == "sac-lb-streak":
        return _without_parts(task) if is_circle2d(task) else {}
    if name not in PAPER_ALGORITHMS:
        return {}
    config, setting = preset(name, task), unprinted(name)
    units = is_circle2d(task)
    found = {"units": replace(config, input_scale=length_scale(task))} if units else {}
    if setting is None:
        return found
    (other,) = set(setting.choices) - {getattr(config, setting.field)}
    found[other] = replace(config, **{setting.field: other})
    if units and setting is TIME_LIMIT:
        found[f"{other}-units"] = replace(found[other], input_scale=length_scale(task))
    return found | ({"library": replace(config, **LIBRARY)} if name == "wcsac" else {})


def _without_parts(task: str) -> dict[str, Any]:
    config, plain = preset("sac-lb-streak", task), preset("sac-lb", task)
    found = {
        f"without-{part}": replace(config, **{field: getattr(plain, field) for field in fields})
        for part, fields in PARTS.items()
    }
    # In the unit of the networks' inputs the same distance between positions.
    length = config.novelty_length / Circle2DConfig().arena
    found["without-scale"] = replace(found["without-scale"], novelty_length=length)
    lower = config.cost_limit - MARGIN
    return found | {"margin": replace(found["without-streak"], cost_limit=lower)}
