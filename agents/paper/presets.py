"""The hyper-parameters that the paper used, by task."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

from agents.algorithms import algorithm
from agents.sac.update import SACConfig
from circle2d_mj.registration import CIRCLE2D, KINEMATIC

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


def preset(name: str, task: str) -> Any:
    """The hyper-parameters of an algorithm for a task: on the paper's tasks the paper's.

    For any other task the defaults of the algorithm's config. Raises UserError for an unknown
    algorithm.
    """
    config = algorithm(name).config()
    off_policy = isinstance(config, SACConfig)
    task = registered_id(task)
    if is_circle2d(task):
        config = replace(config, cost_limit=5.0)  # table Circle2DResults, caption
        if off_policy:
            # See `unprinted`; on-policy methods bootstrap.
            config = replace(config, time_limit="terminal")
    elif task.startswith("circle2d_mj/Safety"):
        # Table HP_SafetyGymnasium; the cost limit, 25, is the default.
        if off_policy:
            config = replace(config, random_steps=50_000, replay_size=500_000)
        elif task.startswith("circle2d_mj/SafetyPointCircle1"):
            config = replace(config, episodes=20)
    return config


def usual_steps(task: str) -> int:
    """Environment steps of a run: the paper's on its tasks, `STEPS` on any other."""
    return PAPER_STEPS.get(registered_id(task), STEPS)


class Unprinted(NamedTuple):
    """A hyper-parameter that the paper does not print, and that decides how runs end."""

    field: str
    choices: dict[str, str]
    """What each of the two means, in words."""


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
        "bootstrap": "values go on behind the time limit of an episode",
    },
)


def unprinted(name: str) -> Unprinted | None:
    """What of an algorithm's preset the paper does not print; None where it prints what decides.

    On Circle2D the presets have the choice that gives the paper's results: the printed step size of
    TRPO-Lag's multiplier fits one optimiser or the other; whether step 50 ends an episode for good
    decides where the off-policy methods end up. (The multipliers of SAC-Lag and WCSAC ascend by
    Adam, as everything else of theirs does.)
    """
    if name == "trpo-lag":
        return MULTIPLIER
    return TIME_LIMIT if isinstance(algorithm(name).config(), SACConfig) else None


def ablation(name: str, task: str) -> tuple[str, Any] | None:
    """The preset with its unprinted hyper-parameter at the other choice, and that choice's name."""
    setting = unprinted(name)
    if setting is None:
        return None
    config = preset(name, task)
    (other,) = set(setting.choices) - {getattr(config, setting.field)}
    return other, replace(config, **{setting.field: other})
