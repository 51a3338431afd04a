"""The configuration of a training: written once into its folder, and read by everything after.

The folder of a training:

    config.json                 its configuration, never changed
    checkpoints/000050000.npz   the whole training state; the two newest stay
    steps/000050000.npz         all that happened since the checkpoint before, run by run
    policies/RUN/000050000.npz  policies kept by `evaluate_every`
    status.json                 progress and time; not a result
    results.npz                 derived once, at the end: all that reports read

A run is one task and one seed. Numbers of files are environment steps.
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
"""Arrays of a checkpoint beside the learner's state."""
ALGORITHM = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*")
"""Names of algorithms: see `agents.algorithms.register`."""
NO_RUNS = "holds no runs: no config.json that circle2d train wrote"
RECORDED = ("versions", "machine", "commit", "spaces", "modules", "device")
"""Entries of config.json that are no settings: what made the runs, and in version 0.3 where."""


class RunId(NamedTuple):
    """A run of a training."""

    task: str
    seed: int

    @property
    def prefix(self) -> str:
        """Beginning of the names of its arrays: "Circle2D-1-v0/0/"."""
        return f"{file_name(self.task)}/{self.seed}/"

    def __str__(self) -> str:
        return f"{self.task}, seed {self.seed}"


def file_name(task: str) -> str:
    """A task's id as a part of a path."""
    return re.sub(r"[/:]", "-", task)


def finished(folder: AnyPath) -> bool:
    """Whether all runs of a training have ended, also by a failure."""
    return (folder / RESULTS).is_file()


def as_stored(value: Any) -> Any:
    """A parameter of a task as its file gives it back: tuples as lists. Raises UserError for what
    that cannot hold, such as keys that are no strings."""
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
    """File of the policy of a run at a step."""
    return numbered_path(folder / POLICIES, run.prefix, step)


class UnregisteredHyperparameters:
    """Base of the hyper-parameters, read from a file, of an algorithm that is not registered."""


@dataclass(frozen=True)
class TrainConfig(Settings):
    """A training: the runs of one algorithm on some tasks, each with some seeds."""

    algorithm: str
    tasks: tuple[str, ...]
    seeds: tuple[int, ...] = (0, 1, 2)
    steps: Annotated[int, In(1)] = presets.STEPS
    """Environment steps of each run; the episode that reaches them is finished."""
    hyperparameters: Any = None
    """The algorithm's config; of an algorithm that is not registered, whose runs can only be
    reported, a dataclass of the same fields."""
    task_parameters: dict[str, Any] = dataclasses.field(default_factory=dict)
    """Keyword arguments for `gymnasium.make`."""
    costs: tuple[str, ...] = ("cost",)
    """Names in the tasks' infos of what is recorded as a cost; an algorithm limits the first, or as
    many as its rule says."""
    checkpoint_every: Annotated[int, In(1)] = 50_000
    """Environment steps of a run between checkpoints, at least: writing them takes 2 % of the time
    at most."""
    evaluate_every: Annotated[int, In(1)] | None = None
    """Environment steps of a run between evaluations, which keep the policy too; None: never."""
    evaluation_episodes: Annotated[int, In(1, 1_000_000)] = 100
    """Episodes that a run's policy is evaluated by at the end, without its noise and with it."""
    vectorization: Vectorization = "auto"
    """How environments run side by side: see `make_envs`."""
    step_timeout: Annotated[float, In(above=0, high=86_400)] | None = None
    """Seconds that a step of environments in processes of their own may take; None: any."""
    tensorboard: bool = False
    """Whether to write TensorBoard event files too."""
    backend: Backend = "c++"
    """How networks are computed. Results differ in their last bits, and so, in the end, in where
    chaos leads."""

    def __post_init__(self) -> None:
        """Raises UserError naming the value that is not allowed."""
        super().__post_init__()
        if not isinstance(self.algorithm, str) or not ALGORITHM.fullmatch(self.algorithm):
            raise UserError(f"algorithm must be a name such as sac-lag, got {self.algorithm!r}")
        for name, kind in (("tasks", str), ("seeds", int), ("costs", str)):
            values = getattr(self, name)
            if not isinstance(values, tuple) or any(type(value) is not kind for value in values):
                raise UserError(f"{name} must be a tuple of {kind.__name__}, got {values!r}")
            if not values or len(set(values)) < len(values):
                raise UserError(f"{name} must be different, at least one, got {values}")
        if min(self.seeds) < 0:
            raise UserError(f"seeds must be in [0, {MOST}], got {self.seeds}")
        if not isinstance(self.task_parameters, dict):
            raise UserError(f"task_parameters must be values by name, got {self.task_parameters!r}")
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
        """An Env or a VectorEnv, which need not reset itself, as the policies of a task see it.
        Raises UserError where a built-in algorithm cannot add to its observations."""
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
        """The runs, a task after the other."""
        return [RunId(task, seed) for task in self.tasks for seed in self.seeds]

    @property
    def stream_seeds(self) -> list[int]:
        """Seeds of the random streams of each run: they depend on its seed and its task."""
        return [stream_seed(run.seed, run.task) for run in self.runs]

    @property
    def most_steps(self) -> int:
        """Steps after which an episode of a task counts as one that never ends."""
        return most_steps(*(time_limit(task, self.task_parameters) for task in self.tasks))

    @property
    def _limit_names(self) -> dict[int, str]:
        """The hyper-parameters that limit a cost, by its number; of an algorithm that is not
        registered, or without a rule of the package's families, `cost_limit`."""
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
        """The hyper-parameters that the learner gets: with `limit_of` episode, limits of an
        episode's cost become limits of its discounted cost, by the mean discount of a step, which
        is their ratio where all steps cost the same; that of the longest streak stays. Raises
        UserError where the tasks have no time limit, or different ones."""
        given = self.hyperparameters
        of_episodes = getattr(given, "multiplier_of", "") == "episode"  # they are compared as given
        if getattr(given, "limit_of", "") != "episode" or of_episodes:
            return given
        limits = {task: time_limit(task, self.task_parameters) for task in self.tasks}
        steps, *others = set(limits.values())
        if steps is None or others:
            raise UserError(
                f"limit_of episode needs tasks with one time limit, got {limits}; limit_of "
                "discounted takes any, and a limit of the discounted cost"
            )
        mean = sum(given.discount**k for k in range(steps)) / steps
        # That of the longest streak has no multiplier that follows a discounted cost.
        names = {*self._limit_names.values()} - {"streak_limit"}
        return dataclasses.replace(given, **{name: mean * getattr(given, name) for name in names})

    @property
    def settings(self) -> dict[str, Any]:
        """Flat dict; hyper-parameters under `hyperparameters.NAME`."""
        content = dataclasses.asdict(self)
        hyperparameters = content.pop("hyperparameters")
        return content | {f"hyperparameters.{k}": value for k, value in hyperparameters.items()}

    def checked(self) -> Spaces:
        """Spaces of the tasks. Raises UserError where a task cannot be made, where tasks do not fit
        together, or the algorithm them, and where the runs need more than the machine's memory."""
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
        """Make the folder of the training; spaces: of `checked`, where it was called before.

        Raises UserError where there is one already, and as `checked`.
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
                _require_none(folder)  # now that no other process can make it
                write_json(folder / CONFIG, content)
        except NoLocks:
            if not there:
                shutil.rmtree(folder)
            raise
        return spaces

    @classmethod
    def read(cls, folder: AnyPath, strict: bool = True) -> TrainConfig:
        """The configuration of a folder: see `parse`. Raises UserError where there is none, naming
        folders of runs below."""
        if not (folder / CONFIG).is_file():
            raise UserError(_no_runs(folder))
        return cls.parse(read_json(folder / CONFIG), folder, strict)

    @classmethod
    def parse(cls, content: Mapping[str, Any], folder: object, strict: bool = True) -> TrainConfig:
        """The configuration that a `config.json` holds.

        folder: of the file, for errors. strict: require that the algorithm is registered; otherwise
        the hyper-parameters of one that is not are a plain frozen dataclass of the file's values,
        so that a report imports nothing. Raises UserError where the content is damaged.
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
    """Spaces of the tasks of a folder, as they were when it was made. UserError where damaged."""
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
    """Words for a folder that holds no runs."""
    if isinstance(folder, Path) and archive_of(folder):
        return f"{folder} is no folder: report, compare and load_runs alone read archives"
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
            f"{folder} holds runs already, which are done: train them on by 'circle2d resume "
            f"{folder} --steps N' or agents.resume({str(folder)!r}, steps=N), or choose another "
            "folder"
        )
    if (folder / CONFIG).exists():
        raise UserError(
            f"{folder} holds runs already: go on with them by 'circle2d resume {folder}' or "
            f"agents.resume({str(folder)!r}), or choose another folder"
        )


def _of(kind: type, values: dict[str, Any]) -> Any:
    """Hyper-parameters of a class from those that a folder holds.

    One that it lacks is newer than its runs, and gets the default of the class that introduced it,
    which leaves training as it was; a subclass may have another default.
    """
    missing = {field.name for field in dataclasses.fields(kind)} - values.keys()
    for base in filter(dataclasses.is_dataclass, kind.__mro__):  # the last is the first to have it
        defaults = {field.name: field.default for field in dataclasses.fields(base)}
        known = {name: defaults[name] for name in missing & defaults.keys()}
        values |= {k: v for k, v in known.items() if v is not dataclasses.MISSING}
    return kind(**values)


def _plain(hyperparameters: dict[str, Any]) -> UnregisteredHyperparameters:
    """A frozen dataclass of values by name."""
    fields = [(name, Any) for name in hyperparameters]
    bases = (UnregisteredHyperparameters,)
    return make_dataclass("Hyperparameters", fields, bases=bases, frozen=True)(**hyperparameters)


def _tuples(parameters: Mapping[str, Any]) -> dict[str, Any]:
    return {k: tuple(v) if isinstance(v, list) else v for k, v in parameters.items()}


def _check_memory(hyperparameters: Any, runs: int, steps: int, sizes: tuple[int, int]) -> None:
    """Raise UserError where replay and networks need more than the machine's memory, by a rough
    estimate.

    steps: of each run, which fill no more of a replay; sizes: numbers that an observation and an
    action hold.
    """
    observation, action = sizes
    capacity = min(getattr(hyperparameters, "replay_size", 0), steps)
    widths = (observation + action, *getattr(hyperparameters, "hidden", ()), 2 * action)
    network = sum((a + 1) * b for a, b in pairwise(widths))
    numbers = capacity * (2 * observation + action + 3) + 5 * 4 * network  # five, with four copies
    needed, there = 4 * runs * numbers, machine_memory()
    if needed > there:
        raise UserError(
            f"replay_size and hidden need about {needed / 1e9:,.1f} GB of memory for {runs} runs; "
            f"this machine has {there / 1e9:,.1f} GB"
        )
    size = getattr(hyperparameters, "replay_size", 0)  # whose memory is asked for at once
    try:
        np.empty((runs, size, 2 * observation + action + 3), dtype=np.float32)
    except (MemoryError, ValueError):
        raise UserError(
            f"replay_size {size} cannot be allocated for {runs} runs, and they take {steps} steps: "
            "more than these are never used"
        ) from None


PACKAGES = ("circle2d-mj", "gymnasium", "mujoco", "numpy", "torch")
CPUINFO = Path("/proc/cpuinfo")
LARGEST = 2**40
"""Bytes of memory where the system does not tell them."""


def made_with() -> dict[str, Any]:
    """Versions and machine of this process, without times."""
    versions = {"python": platform.python_version()} | {name: version(name) for name in PACKAGES}
    machine = {"processor": _processor(), "cores": os.cpu_count() or 1}
    return {"versions": versions, "machine": machine}


def commit() -> str | None:
    """Commit of this code, "-dirty" behind it where files are changed: that of the checkout it lies
    in, or that pip installed it from; None for an installation from anything else."""
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
    """Bytes of the machine's memory."""
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):  # not on Windows
        return LARGEST


def _processor() -> str:
    """The name that Linux gives, or else the platform's."""
    try:
        lines = CPUINFO.read_text(errors="replace").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return next(filter(None, names), platform.processor() or platform.machine())
