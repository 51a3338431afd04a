"""The paper's experiments as data: the trainings, in order, and choices of settings that the paper
does not specify."""

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
"""Runs of an algorithm on a task. Source: captions of tables Circle2DResults and
SafetyGymnasiumResults."""
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
    """Return the ids of Circle2D on some levels, kinematic or with physics. Raises UserError for
    unknown levels."""
    if not levels or not set(levels) <= set(LEVELS):
        raise UserError(f"levels must be among {list(LEVELS)}, got {list(levels)}")
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
    """Return the benchmark's trainings by folder `out/TASK/ALGORITHM`, the longest ones first.

    By default runs have 1 000 000 steps, with ten seeds on Circle2D (five for off-policy
    algorithms) and three on other tasks. quick: two seeds with the fewest steps that give a table.
    Otherwise as `agents.training.grid.grid`.
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
    """A hyper-parameter that the paper does not specify, although it decides how runs end."""

    field: str
    choices: dict[str, str]
    """The two values, each with its meaning in words."""


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
    """Return an algorithm's decisive hyper-parameter that the paper does not specify; None if none.

    The printed step size of TRPO-Lag's multiplier fits either optimiser. Whether an episode of
    Circle2D terminates at step 50 decides where the off-policy methods end up. results/README.md
    compares both choices with the paper's results. (The multipliers of SAC-Lag and WCSAC ascend by
    Adam, like their other parameters.)
    """
    if name == "trpo-lag":
        return MULTIPLIER
    off_policy = name in PAPER_ALGORITHMS and algorithm(name).off_policy
    return TIME_LIMIT if off_policy else None


LIBRARY = {"variance_target": "unsquared", "damping_gradient": "through"}
"""Settings of WCSAC as in a later library of the paper's group: see `WCSACConfig`."""


STREAK_PARTS = {
    "streak": ("streak_weight",),
    "brown": ("random_exponent",),
    "share": ("random_share",),
    "novelty": ("novelty_bonus",),
    "horizon": ("time_limit",),
    "scale": ("input_scale",),
    "speed": ("learning_rate", "temperature_lr", "batch_size", "gradient_steps"),
}
"""The hyper-parameters in which SAC-LB-Streak differs from SAC-LB on Circle2D, by part."""
LIMIT_MARGIN = 1.5
"""How much the cost limit is lowered in the control that has a margin instead of the streak
cost."""


def ablations(name: str, task: str) -> dict[str, dict[str, Any]]:
    """Return hyper-parameters that replace the preset's, by the name of the ablation.

    For the paper's algorithms: other choices of what the paper does not specify. On Circle2D one of
    them is "units": observations in units of length instead of half the arena. For SAC-LB-Streak on
    Circle2D: SAC-LB's values for each of the `STREAK_PARTS`, and a lower cost limit in place of the
    streak cost. The ablation without the input scale rescales the novelty bonus's length, so that
    distances between positions stay the same; with physics, a place then counts as new at each
    speed.
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
    # The same distance between positions, in the unit of the networks' inputs.
    found["without-scale"]["novelty_length"] = config.novelty_length / Circle2DConfig().arena
    lower = {"cost_limit": config.cost_limit - LIMIT_MARGIN}
    return found | {"margin": found["without-streak"] | lower}
