"""The paper's experiments as data: which trainings there are, in which order, and the choices of
settings that it does not specify."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from agents.algorithms import algorithm
from agents.errors import UserError
from agents.presets import LENGTHS, PAPER_STEPS, is_circle2d, preset, registered_id
from agents.training import grid
from agents.training.config import TrainConfig
from circle2d_mj.circle2d.config import LEVELS, Circle2DConfig
from circle2d_mj.registration import KINEMATIC, PHYSICS

PAPER_ALGORITHMS = ("trpo-lag", "cpo", "sac-lag", "sac-lb", "wcsac")
"""The algorithms that the paper compares, in the order of its tables."""
PAPER_SEEDS = 3
"""Runs of an algorithm on a task. Tables Circle2DResults and SafetyGymnasiumResults, captions."""
SEEDS = tuple(range(PAPER_SEEDS))
QUICK_SEEDS, QUICK_STEPS = (0, 1), 10_000
BENCHMARK_STEPS = 1_000_000
QUICK_SAFETY_STEPS = 30_000
"""Three epochs of ten episodes: EMCC needs a rollout in each third."""
SAFETY = tuple(task for task in PAPER_STEPS if "Safety" in task)
"""The paper's tasks of Safety-Gymnasium."""
BENCHMARK = (
    *KINEMATIC.values(),
    *(f"circle2d_mj/Safety{task}" for task in ("PointGoal1-v0", "CarGoal1-v0", "PointButton1-v0")),
    *(f"circle2d_mj/Safety{task}" for task in ("PointPush1-v0", "HalfCheetahVelocity-v1")),
)
"""The tasks of the benchmark."""


def circle2d_tasks(levels: Sequence[int], mujoco: bool) -> list[str]:
    """The ids of Circle2D on some levels, kinematic or with physics. Raises UserError."""
    if not levels or not set(levels) <= set(LEVELS):
        raise UserError(f"levels must be some of {list(LEVELS)}, got {list(levels)}")
    ids = PHYSICS if mujoco else KINEMATIC
    return [ids[level] for level in dict.fromkeys(levels)]


def benchmark(
    out: Path,
    tasks: Sequence[str],
    algorithms: Sequence[str],
    seeds: Sequence[int] | None = None,
    steps: int | None = None,
    quick: bool = False,
    task_parameters: Mapping[str, Any] | None = None,
) -> dict[Path, TrainConfig]:
    """The trainings of the benchmark, by folder `out/TASK/ALGORITHM`; what takes longest first.

    By default runs have 1 000 000 steps, and there are ten seeds on Circle2D, five off-policy, and
    three on other tasks. quick: two seeds of as few steps as give a table. Otherwise as
    `agents.training.grid.grid`.
    """
    trainings = {}
    for task in dict.fromkeys(tasks):
        circle2d = is_circle2d(task)
        usual = (QUICK_STEPS if circle2d else QUICK_SAFETY_STEPS) if quick else BENCHMARK_STEPS
        for name in dict.fromkeys(algorithms):
            count = (5 if algorithm(name).off_policy else 10) if circle2d else 3
            chosen = (QUICK_SEEDS if quick else range(count)) if seeds is None else seeds
            length = steps or usual
            trainings |= grid.grid(out, [task], [name], chosen, length, task_parameters)
    return dict(sorted(trainings.items(), key=lambda pair: -grid.work(pair[1])))


class Unprinted(NamedTuple):
    """A hyper-parameter that the paper does not specify, and that decides how runs end."""

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
    """The hyper-parameter that decides and is not specified in the paper; None where there is none.

    The printed step size of TRPO-Lag's multiplier fits one optimiser or the other; whether step 50
    ends an episode of Circle2D for good decides where the off-policy methods end up. What either
    choice gives beside the paper's results: results/README.md. (The multipliers of SAC-Lag and
    WCSAC ascend by Adam, as everything else of theirs does.)
    """
    if name == "trpo-lag":
        return MULTIPLIER
    off_policy = name in PAPER_ALGORITHMS and algorithm(name).off_policy
    return TIME_LIMIT if off_policy else None


LIBRARY = {"variance_target": "unsquared", "damping_gradient": "through"}
"""WCSAC as in a later library of the paper's group: see `WCSACConfig`."""


STREAK_PARTS = {
    "streak": ("streak_weight",),
    "brown": ("random_exponent",),
    "share": ("random_share",),
    "novelty": ("novelty_bonus",),
    "horizon": ("time_limit",),
    "scale": ("input_scale",),
    "speed": ("learning_rate", "temperature_lr", "batch_size", "gradient_steps"),
}
"""The hyper-parameters that SAC-LB-Streak has on Circle2D in the place of SAC-LB's, by part."""
LIMIT_MARGIN = 1.5
"""How far the cost limit falls in the control that has a margin instead of the streak cost."""


def ablations(name: str, task: str) -> dict[str, dict[str, Any]]:
    """Values instead of the preset's, by the name of the change: several for each algorithm.

    For the paper's algorithms: other choices of what the paper does not specify. On Circle2D the
    unit of observations is one of them: "units" is that of length instead of the half arena. For
    SAC-LB-Streak on Circle2D: SAC-LB's values for one of its `STREAK_PARTS`, and a lower cost limit
    in the place of the streak cost. Without the unit of length the bonus for new states keeps its
    length between positions; with physics it counts a place anew at every speed.
    """
    if name == "sac-lb-streak":
        return _without_parts(task) if is_circle2d(task) else {}
    if name not in PAPER_ALGORITHMS:
        return {}
    config, setting = preset(name, task), unprinted(name)
    units = is_circle2d(task)
    found: dict[str, dict[str, Any]] = {}
    if units:
        found["units"] = {"input_scale": LENGTHS[registered_id(task)]}
    if setting is None:
        return found
    (other,) = set(setting.choices) - {getattr(config, setting.field)}
    found[other] = {setting.field: other}
    if units and setting is TIME_LIMIT:
        found[f"{other}-units"] = found[other] | found["units"]
    return found | ({"library": LIBRARY} if name == "wcsac" else {})


def _without_parts(task: str) -> dict[str, dict[str, Any]]:
    config, plain = preset("sac-lb-streak", task), preset("sac-lb", task)
    found = {
        f"without-{part}": {field: getattr(plain, field) for field in fields}
        for part, fields in STREAK_PARTS.items()
    }
    # In the unit of the networks' inputs the same distance between positions.
    found["without-scale"]["novelty_length"] = config.novelty_length / Circle2DConfig().arena
    lower = {"cost_limit": config.cost_limit - LIMIT_MARGIN}
    return found | {"margin": found["without-streak"] | lower}
