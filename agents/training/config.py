"""The configuration of a training: written into its folder, and read from there later.

The folder of a training:

    config.json                 its configuration, which only `resume` with more steps changes
    checkpoints/000050000.npz   the whole training state; the two newest stay
    steps/000050000.npz         the episodes since the previous checkpoint, run by run
    policies/RUN/000050000.npz  policies kept by `evaluate_every`
    status.json                 progress and time; no result depends on it
    results.npz                 derived once, at the end: all that reports read

A run has one task and one seed. The numbers of files are environment steps.
"""

from __future__ import annotations

import dataclasses
import json
import os
import platform
import re
import shutil
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass, make_dataclass
from importlib.metadata import distribution, version
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np

from agents import presets
from agents.algorithms import ALGORITHMS, BUILT_IN, algorithm, module_of
from agents.checks import MOST, In, Settings
from agents.errors import UserError
from agents.lockstep.kernel import Backend
from agents.lockstep.noise import stream_seed
from agents.training.environments import (
    Spaces,
    Vectorization,
    module_of_task,
    most_steps,
    spaces_of,
    time_limit,
)
from agents.training.files import (
    AnyPath,
    NoLocks,
    archive_of,
    check_folder,
    locked,
    numbered_path,
    read_json,
    write_json,
)

CONFIG, STATUS, RESULTS = "config.json", "status.json", "results.npz"
CHECKPOINTS, STEPS, POLICIES = "checkpoints", "steps", "policies"
COUNTERS = ("epoch", "steps", "failures", "tracebacks")
"""Names of a checkpoint's arrays that are not the learner's state."""
ALGORITHM = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*")
"""Names of algorithms: see `agents.algorithms.register`."""
NO_RUNS = "holds no runs: no config.json that circle2d train wrote"
RECORDED = ("versions", "machine", "commit", "spaces", "modules", "device")
"""Entries of config.json that are no settings, but say how the runs were made."""


class RunId(NamedTuple):
    """Identifies a run of a training."""

    task: str
    seed: int

    @property
    def prefix(self) -> str:
        """Prefix of the names of the run's arrays, such as "Circle2D-1-v0/0/"."""
        return f"{file_name(self.task)}/{self.seed}/"

    def __str__(self) -> str:
        return f"{self.task}, seed {self.seed}"


def file_name(task: str) -> str:
    """Return a task's id as a part of a path."""
    return re.sub(r"[/:]", "-", task)


def finished(folder: AnyPath) -> bool:
    """Whether all runs of a training have ended, be it by a failure."""
    return (folder / RESULTS).is_file()


def as_stored(value: Any) -> Any:
    """Return a task parameter as JSON gives it back: tuples as lists. Raises UserError for what
    JSON cannot hold, such as keys that are no strings."""
    if isinstance(value, dict):
        if other := [key for key in value if not isinstance(key, str)]:
            raise UserError(f"keys in task_parameters must be strings, got {other[0]!r}")
        return {key: as_stored(own) for key, own in value.items()}
    if isinstance(value, (list, tuple)):
        return [as_stored(own) for own in value]
    if value is None or isinstance(value, (str, bool, int, float)):
        return value
    raise UserError(f"values in task_parameters must be plain, got {value!r}")


def is_of_policy(name: str) -> bool:
    """Whether an array of a learner's state is one of its policy."""
    return name == "actor" or name.startswith("actor.")


def policy_path(folder: Path, run: RunId, step: int) -> Path:
    """Return the path of the policy of a run that was kept at a step."""
    return numbered_path(folder / POLICIES, run.prefix, step)


class UnregisteredHyperparameters:
    """Base of hyper-parameters read from a file whose algorithm is not registered."""


@dataclass(frozen=True)
class TrainConfig(Settings):
    """A training: the runs of one algorithm, one for each task and seed."""

    algorithm: str
    tasks: tuple[str, ...]
    seeds: tuple[int, ...] = (0, 1, 2)
    steps: Annotated[int, In(1)] = presets.STEPS
    """Environment steps of each run; the episode that reaches them is finished."""
    hyperparameters: Any = None
    """The algorithm's config. For an algorithm that is not registered, whose runs can only be
    reported, a dataclass with the same fields."""
    task_parameters: dict[str, Any] = dataclasses.field(default_factory=dict)
    """Keyword arguments for `gymnasium.make`."""
    costs: tuple[str, ...] = ("cost",)
    """Names, in the tasks' infos, of the costs to record. The algorithm limits the first, or as
    many as its rule says."""
    checkpoint_every: Annotated[int, In(1)] = 50_000
    """Least number of environment steps of a run between checkpoints, which may be more: writing
    takes at most 2 % of the time."""
    evaluate_every: Annotated[int, In(1)] | None = None
    """Environment steps of a run between evaluations, which also keep the policy; None: never."""
    evaluation_episodes: Annotated[int, In(1, 1_000_000)] = 100
    """Episodes of a run's final evaluation, as many without the policy's noise as with it."""
    vectorization: Vectorization = "auto"
    """How environments run side by side: see `make_envs`."""
    step_timeout: Annotated[float, In(above=0, high=86_400)] | None = None
    """Seconds that a step of environments in separate processes may take; None: any number."""
    tensorboard: bool = False
    """Whether to write TensorBoard event files as well."""
    backend: Backend = "c++"
    """How networks are computed. Backends differ in the last bits of their numbers; as training is
    chaotic, results come to differ too."""

    def __post_init__(self) -> None:
        """Check the values. Raises UserError naming one that is not allowed."""
        super().__post_init__()
        if not isinstance(self.algorithm, str) or not ALGORITHM.fullmatch(self.algorithm):
            raise UserError(f"algorithm must be a name such as sac-lag, got {self.algorithm!r}")
        for name, kind in (("tasks", str), ("seeds", int), ("costs", str)):
            values = getattr(self, name)
            if not isinstance(values, tuple) or any(type(value) is not kind for value in values):
                raise UserError(f"{name} must be a tuple of {kind.__name__}, got {values!r}")
            if not values or len(set(values)) < len(values):
                raise UserError(f"{name} must be one or more different values, got {values}")
        if min(self.seeds) < 0:
            raise UserError(f"seeds must be in [0, {MOST}], got {self.seeds}")
        if not isinstance(self.task_parameters, dict):
            raise UserError(f"task_parameters must be a dict, got {self.task_parameters!r}")
        object.__setattr__(self, "task_parameters", as_stored(self.task_parameters))
        if not isinstance(self.hyperparameters, UnregisteredHyperparameters):
            self._check_algorithm()

    def _check_algorithm(self) -> None:
        known = algorithm(self.algorithm)
        if type(self.hyperparameters) is not known.config:
            raise UserError(
                f"hyperparameters of {self.algorithm} must be a {known.config.__name__}, "
                f"got {self.hyperparameters!r}"
            )
        if (learned := getattr(known.rule, "costs", 1)) > len(self.costs):
            raise UserError(f"{self.algorithm} limits {learned} costs, got costs {self.costs}")
        others = [name for name in self.costs if name not in self._added]
        costs = (*others[:learned], *self._added, *others[learned:])
        object.__setattr__(self, "costs", costs)

    @property
    def _added(self) -> tuple[str, ...]:
        """Names of the costs that `wrap` adds to those of the task."""
        added = getattr(self.hyperparameters, "added_costs", None)
        return added(self.costs) if added else ()

    @property
    def task_costs(self) -> tuple[str, ...]:
        """Names of the costs in the tasks' own infos."""
        return tuple(name for name in self.costs if name not in self._added)

    def wrap(self, env: Any, task: str) -> Any:
        """Return an Env or a VectorEnv of a task as policies see it; it need not reset itself.
        Raises UserError if a built-in algorithm cannot add to its observations."""
        if not hasattr(self.hyperparameters, "wrap"):
            return env
        limit = time_limit(task, self.task_parameters)
        try:
            return self.hyperparameters.wrap(env, self.costs, limit)
        except TypeError as error:
            if self.algorithm not in BUILT_IN:
                raise
            raise UserError(f"{self.algorithm} on task {task!r}: {error}") from error

    @property
    def runs(self) -> list[RunId]:
        """The runs, task by task."""
        return [RunId(task, seed) for task in self.tasks for seed in self.seeds]

    @property
    def stream_seeds(self) -> list[int]:
        """Seed of each run's random streams, from the seed and the task of the run."""
        return [stream_seed(run.seed, run.task) for run in self.runs]

    @property
    def most_steps(self) -> int:
        """Steps after which an episode is taken to never end."""
        return most_steps(*(time_limit(task, self.task_parameters) for task in self.tasks))

    @property
    def _limit_names(self) -> dict[int, str]:
        """Name of the hyper-parameter that limits each cost, by the index of the cost; `cost_limit`
        for an algorithm that is not registered, or whose rule declares no limits."""
        rule = ALGORITHMS[self.algorithm].rule if self.algorithm in ALGORITHMS else None
        if hasattr(rule, "limits"):
            from agents.lockstep import lagrange  # torch, which the rule has imported

            rule = lagrange.with_streaks(rule, self.hyperparameters)
            return lagrange.limit_names(rule, self.hyperparameters)
        return {0: "cost_limit"} if hasattr(self.hyperparameters, "cost_limit") else {}

    @property
    def limits(self) -> dict[str, float]:
        """The limit of each cost that the algorithm limits."""
        names = self._limit_names.items()
        return {self.costs[k]: getattr(self.hyperparameters, name) for k, name in names}

    @property
    def learned(self) -> Any:
        """The hyper-parameters that the learner gets. With `limit_of` episode, limits of an
        episode's cost become limits of its discounted cost: they are multiplied by the mean
        discount of a step, the ratio of both costs if all steps cost the same. The limit of the
        longest streak stays. Raises UserError if the tasks have no time limit, or different
        ones."""
        given = self.hyperparameters
        of_episodes = getattr(given, "multiplier_of", "") == "episode"  # limits stay as given
        if getattr(given, "limit_of", "") != "episode" or of_episodes:
            return given
        limits = {task: time_limit(task, self.task_parameters) for task in self.tasks}
        steps, *others = set(limits.values())
        if steps is None or others:
            raise UserError(
                f"limit_of episode needs tasks with one time limit, got {limits}; limit_of "
                "discounted takes any tasks: cost_limit is then that of the discounted cost"
            )
        mean = sum(given.discount**k for k in range(steps)) / steps
        # No multiplier of the longest streak follows a discounted cost.
        names = {*self._limit_names.values()} - {"streak_limit"}
        return dataclasses.replace(given, **{name: mean * getattr(given, name) for name in names})

    @property
    def settings(self) -> dict[str, Any]:
        """The settings as a flat dict; hyper-parameters have the keys `hyperparameters.NAME`."""
        content = dataclasses.asdict(self)
        hyperparameters = content.pop("hyperparameters")
        return content | {f"hyperparameters.{k}": value for k, value in hyperparameters.items()}

    def checked(self) -> Spaces:
        """Return the spaces of the tasks. Raises UserError if a task cannot be made, if tasks do
        not fit together or do not fit the algorithm, or if the runs need too much memory."""
        spaces = spaces_of(self.tasks, self.task_parameters, self.wrap)
        _check_memory(self.learned, len(self.runs), self.steps, spaces.sizes)
        scale = getattr(self.hyperparameters, "input_scale", 1.0)
        if isinstance(scale, tuple) and len(scale) != spaces.observation_size:
            raise UserError(
                f"input_scale must be one number, or {spaces.observation_size}, as an observation "
                f"of {self.tasks[0]} has, got {scale}"
            )
        return spaces

    def write(self, folder: Path, spaces: Spaces | None = None) -> Spaces:
        """Make the folder of the training; spaces: what `checked` returned, if called before.

        Raises UserError if the folder holds runs already, and as `checked`.
        """
        check_folder(folder)
        _require_none(folder)
        spaces = spaces or self.checked()
        modules = [module_of(self.algorithm), *map(module_of_task, self.tasks)]
        modules = [*dict.fromkeys(name for name in modules if name)]  # "" of built-in ones
        content = dataclasses.asdict(self) | made_with()
        content |= {"commit": commit(), "modules": modules, "spaces": spaces._asdict()}
        try:
            json.dumps(content["hyperparameters"])
        except (TypeError, ValueError, RecursionError) as error:
            raise UserError(f"hyperparameters must be plain values: {error}") from None
        there = folder.exists()
        folder.mkdir(parents=True, exist_ok=True)
        try:
            with locked(folder):
                _require_none(folder)  # again, now that no other process can make it
                write_json(folder / CONFIG, content)
        except NoLocks:
            if not there:
                shutil.rmtree(folder)
            raise
        return spaces

    @classmethod
    def read(cls, folder: AnyPath, strict: bool = True) -> TrainConfig:
        """Read the configuration of a folder: see `parse`. Raises UserError, naming folders of runs
        below, if there is none."""
        if not (folder / CONFIG).is_file():
            raise UserError(_no_runs(folder))
        return cls.parse(read_json(folder / CONFIG), folder, strict)

    @classmethod
    def parse(cls, content: Mapping[str, Any], folder: object, strict: bool = True) -> TrainConfig:
        """Return the configuration that a `config.json` holds.

        folder: that of the file, for errors. strict: require that the algorithm is registered;
        otherwise an algorithm that is not has a plain frozen dataclass of the file's values as
        hyper-parameters, so that a report imports nothing. Raises UserError if the content is
        damaged.
        """
        if "task" in content:
            raise UserError(f"{folder} is of version 0.2, whose folders this version does not read")
        name, modules = content.get("algorithm"), content.get("modules") or ()
        if strict and isinstance(name, str) and name not in ALGORITHMS and modules:
            how = "import {0} first (--import {0})".format(modules[0])
            if "__main__" in modules:
                how = "register it in a module, not in a script"
            raise UserError(f"algorithm {name!r} of {folder} is not registered here: {how}")
        try:
            values = _tuples({k: v for k, v in content.items() if k not in RECORDED})
            if values.get("backend") in ("compiled", "eager"):  # of version 0.3
                del values["backend"]
            own = _tuples(values.pop("hyperparameters"))
            known = algorithm(str(name)).config if strict or name in ALGORITHMS else None
            return cls(hyperparameters=_of(known, own) if known else _plain(own), **values)
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            words = f"{folder}/{CONFIG} is damaged, or {name} has changed since"
            raise UserError(f"{words}: {error}") from error


def read_spaces(folder: AnyPath) -> Spaces:
    """Read the spaces that a folder's tasks had when it was made. Raises UserError if damaged."""
    content: Any = read_json(folder / CONFIG).get("spaces")
    try:
        low, high = (tuple(map(float, content[name])) for name in ("low", "high"))
        spaces = Spaces(int(content["observation_size"]), low, high, str(content["dtype"]))
        if len(low) != len(high) or not all(a < b for a, b in zip(low, high, strict=True)):
            raise ValueError(f"bounds of actions must be increasing, got {content}")
        return spaces
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise UserError(f"{folder / CONFIG} is damaged: spaces: {error}") from None


def _no_runs(folder: AnyPath) -> str:
    """Return the message for a folder that holds no runs."""
    if isinstance(folder, Path) and archive_of(folder):
        return f"{folder} is no folder: only report, compare and load_runs read archives"
    if not folder.is_dir():
        return f"{folder} is no folder"
    below: list[Path] = []
    if isinstance(folder, Path):
        below = sorted([*folder.glob("*/" + CONFIG), *folder.glob("*/*/" + CONFIG)])
    if not below:
        return f"{folder} {NO_RUNS}"
    names = ", ".join(f"'{path.parent}'" for path in below[:3])
    return f"{folder} holds folders of runs: did you mean {names}?"


def _require_none(folder: Path) -> None:
    if finished(folder):
        raise UserError(
            f"{folder} holds runs already, which are done: train them longer by 'circle2d resume "
            f"{folder} --steps N' or agents.resume({str(folder)!r}, steps=N), or choose another "
            "folder"
        )
    if (folder / CONFIG).exists():
        raise UserError(
            f"{folder} holds runs already: go on with them by 'circle2d resume {folder}' or "
            f"agents.resume({str(folder)!r}), or choose another folder"
        )


def _of(kind: type, values: dict[str, Any]) -> Any:
    """Return hyper-parameters of a class from the values that a folder holds.

    A hyper-parameter that the folder lacks is newer than its runs. It gets the default of the class
    that introduced it, which leaves training as it was; a subclass may have another default.
    """
    missing = {field.name for field in dataclasses.fields(kind)} - values.keys()
    for base in filter(dataclasses.is_dataclass, kind.__mro__):  # the last introduced it
        defaults = {field.name: field.default for field in dataclasses.fields(base)}
        known = {name: defaults[name] for name in missing & defaults.keys()}
        values |= {k: v for k, v in known.items() if v is not dataclasses.MISSING}
    return kind(**values)


def _plain(hyperparameters: dict[str, Any]) -> UnregisteredHyperparameters:
    """Return a frozen dataclass of values by name."""
    fields = [(name, Any) for name in hyperparameters]
    bases = (UnregisteredHyperparameters,)
    return make_dataclass("Hyperparameters", fields, bases=bases, frozen=True)(**hyperparameters)


def _tuples(parameters: Mapping[str, Any]) -> dict[str, Any]:
    return {k: tuple(v) if isinstance(v, list) else v for k, v in parameters.items()}


def _check_memory(hyperparameters: Any, runs: int, steps: int, sizes: tuple[int, int]) -> None:
    """Raise UserError if replay buffers and networks need more than the machine's memory.

    This is a rough estimate. steps: environment steps of each run, an upper bound of its
    transitions; sizes: numbers in an observation and in an action.
    """
    observation, action = sizes
    capacity = min(getattr(hyperparameters, "replay_size", 0), steps)
    widths = (observation + action, *getattr(hyperparameters, "hidden", ()), 2 * action)
    network = sum((a + 1) * b for a, b in pairwise(widths))
    numbers = capacity * (2 * observation + action + 3) + 5 * 4 * network  # 5 networks, 4 copies
    needed, there = 4 * runs * numbers, machine_memory()
    if needed > there:
        raise UserError(
            f"replay_size and hidden need about {needed / 1e9:,.1f} GB of memory for {runs} runs; "
            f"this machine has {there / 1e9:,.1f} GB"
        )
    size = getattr(hyperparameters, "replay_size", 0)  # it is allocated at once
    try:
        np.empty((runs, size, 2 * observation + action + 3), dtype=np.float32)
    except (MemoryError, ValueError):
        raise UserError(
            f"replay_size {size} cannot be allocated for {runs} runs: give at most {steps}, the "
            "steps of a run; more is never used"
        ) from None


PACKAGES = ("circle2d-mj", "gymnasium", "mujoco", "numpy", "torch")
CPUINFO = Path("/proc/cpuinfo")
LARGEST = 2**40
"""Bytes of memory to assume if the system does not tell."""


def made_with() -> dict[str, Any]:
    """Return the versions and the machine of this process, without times."""
    versions = {"python": platform.python_version()} | {name: version(name) for name in PACKAGES}
    machine = {"processor": _processor(), "cores": os.cpu_count() or 1}
    return {"versions": versions, "machine": machine}


def commit() -> str | None:
    """Return the commit of the checkout that this code lies in, with "-dirty" if files are changed,
    or the commit that pip installed it from; None if there is neither."""
    root = Path(__file__).parents[2]
    if (root / ".git").exists():
        git = ("git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=40")
        try:
            done = subprocess.run(
                [*git, "--exclude=*"], capture_output=True, encoding="utf-8", check=True
            )
        except (OSError, subprocess.CalledProcessError):
            return None
        return done.stdout.strip()
    origin = json.loads(distribution("circle2d-mj").read_text("direct_url.json") or "{}")
    return origin.get("vcs_info", {}).get("commit_id")


def machine_memory() -> int:
    """Return the bytes of the machine's memory."""
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):  # not on Windows
        return LARGEST


def _processor() -> str:
    """Return the processor's name from Linux, or else from `platform`."""
    try:
        lines = CPUINFO.read_text(errors="replace").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return next(filter(None, names), platform.processor() or platform.machine())
