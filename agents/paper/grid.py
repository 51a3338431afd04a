"""The paper's experiments as data: which trainings there are, in which order, and the choices of
settings that it does not print."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from agents.algorithms import algorithm
from agents.errors import UserError
from agents.paper.presets import (
    PAPER_ALGORITHMS,
    PAPER_SEEDS,
    PAPER_STEPS,
    is_circle2d,
    is_off_policy,
    length_scale,
    preset,
    usual_steps,
)
from agents.training.config import CONFIG, TrainConfig, file_name
from agents.training.environments import spaces_of
from circle2d_mj.circle2d.config import LEVELS, Circle2DConfig
from circle2d_mj.registration import KINEMATIC, PHYSICS

SEEDS = tuple(range(PAPER_SEEDS))
QUICK_SEEDS, QUICK_STEPS = (0, 1), 10_000
WORK = {"trpo-lag": 1.0, "cpo": 1.3, "sac-lag": 5.0, "sac-lb": 5.0, "wcsac": 5.2}
WORK |= {"ppo-lag": 2.4, "ppo": 2.4, "sac": 4.8, "sac-lb-streak": 7.5}
WORK |= dict.fromkeys(("cppo-pid", "focops", "p3o", "ipo"), 2.4) | {"cup": 3.5}
WORK |= {
    "crpo": 1.0,
    "rcpo": 1.0,
    "trpo-pid": 1.0,
    "pcpo": 1.3,
    "c-trpo": 1.3,
    "sac-pid": 5.0,
    "cal": 7.0,
}
UNKNOWN_WORK = max(WORK.values())
"""Time of a step of an algorithm on Circle2D, in that of TRPO-Lag's; of one that is not listed the
largest. Decides the order (what takes longest goes first) and the time left that is shown; no
result."""
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
MOST_RUNS = 12
"""In a training of several tasks; more make a step of each hardly cheaper."""


def circle2d_tasks(levels: Sequence[int], mujoco: bool) -> list[str]:
    """The ids of Circle2D on some levels, kinematic or with physics. Raises UserError."""
    if not levels or not set(levels) <= set(LEVELS):
        raise UserError(f"levels must be some of {list(LEVELS)}, got {list(levels)}")
    ids = PHYSICS if mujoco else KINEMATIC
    return [ids[level] for level in dict.fromkeys(levels)]


def grid(
    out: Path,
    tasks: Sequence[str],
    algorithms: Sequence[str],
    seeds: Sequence[int],
    steps: int | None = None,
    with_ablations: bool = False,
    task_parameters: Mapping[str, Any] | None = None,
) -> dict[Path, TrainConfig]:
    """The trainings of every algorithm on every task with its preset, by folder; what takes longest
    first.

    The folder of an algorithm is `out/ALGORITHM` where all tasks train in it together: they have
    equal presets and spaces, and are few. Otherwise each task has its own, `out/TASK/ALGORITHM`.
    steps: of each run; by default the usual ones of its task. with_ablations: those of `ablations`
    as well, in folders like trpo-lag-sgd. Raises UserError for what is unknown.
    """
    tasks = list(dict.fromkeys(tasks))
    order = sorted(dict.fromkeys(algorithms), key=lambda name: -WORK.get(name, UNKNOWN_WORK))
    trainings = {}
    for name in order:
        choices: dict[str, dict[str, Any]] = {}  # hyper-parameters by folder, then task
        for task in tasks:
            others = ablations(name, task) if with_ablations else {}
            chosen = {name: preset(name, task)} | {f"{name}-{k}": v for k, v in others.items()}
            for folder, hyperparameters in chosen.items():
                choices.setdefault(folder, {})[task] = hyperparameters
        for folder, by_task in choices.items():
            lengths = {task: steps or usual_steps(task) for task in by_task}
            alike = len({repr((by_task[task], lengths[task])) for task in by_task}) == 1
            few = len(by_task) > 1 and len(by_task) * len(seeds) <= MOST_RUNS
            if alike and few and _equal_spaces(tuple(by_task)):
                parts = {out / folder: list(by_task)}
            else:
                parts = {out / file_name(task) / folder: [task] for task in by_task}
            for path, together in parts.items():
                length, own = lengths[together[0]], by_task[together[0]]
                parameters = dict(task_parameters or {})
                trainings[path] = TrainConfig(
                    name, tuple(together), tuple(seeds), length, own, parameters
                )
    return trainings


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
    three on other tasks. quick: two seeds of as few steps as give a table. Otherwise as `grid`.
    """
    trainings = {}
    for task in dict.fromkeys(tasks):
        circle2d = is_circle2d(task)
        usual = (QUICK_STEPS if circle2d else QUICK_SAFETY_STEPS) if quick else BENCHMARK_STEPS
        for name in dict.fromkeys(algorithms):
            count = (10 if hasattr(preset(name, task), "episodes") else 5) if circle2d else 3
            chosen = (QUICK_SEEDS if quick else range(count)) if seeds is None else seeds
            length = steps or usual
            trainings |= grid(out, [task], [name], chosen, length, False, task_parameters)
    return dict(sorted(trainings.items(), key=lambda pair: -work(pair[1])))


@functools.cache
def _equal_spaces(tasks: tuple[str, ...]) -> bool:
    """Whether tasks can train together."""
    try:
        spaces_of(tasks, {})
    except UserError:  # for one that cannot be made, too, which its training says
        return False
    return True


def shard(folders: Mapping[Path, TrainConfig], part: int, count: int) -> dict[Path, TrainConfig]:
    """The `part`-th of `count` parts of a grid, from 1 on, which take about equally long.

    Depends on nothing that has been trained, so that the parts of a grid have no folder in common.
    """
    order = sorted(folders, key=lambda folder: -work(folders[folder]))  # stable
    return {folder: folders[folder] for folder in order[part - 1 :: count]}


def work(config: TrainConfig) -> float:
    """Time that a training takes, in steps of a run of TRPO-Lag."""
    return WORK.get(config.algorithm, UNKNOWN_WORK) * config.steps * len(config.runs)


def prepare(folders: Mapping[Path, TrainConfig]) -> None:
    """Make the folders that are not there yet.

    Raises UserError, before anything is made, where one holds runs of another configuration.
    """
    there = [folder for folder in folders if (folder / CONFIG).exists()]
    for folder in there:
        theirs, ours = TrainConfig.read(folder).settings, folders[folder].settings
        changed = [
            f"{k} {theirs.get(k, 'absent')} (now {ours.get(k, 'absent')})"
            for k in theirs | ours
            if repr(theirs.get(k)) != repr(ours.get(k))
        ]
        if changed:
            raise UserError(
                f"{folder} holds runs with other settings: {', '.join(changed)}; choose another "
                "folder for out"
            )
    for folder, config in folders.items():
        if folder not in there:
            config.write(folder)


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
    off_policy = name in PAPER_ALGORITHMS and is_off_policy(algorithm(name).config)
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


@functools.cache  # asked for each group of a report
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
