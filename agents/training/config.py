"""Configuration of some runs: written once into their folder, and read by everything after."""

from __future__ import annotations

import dataclasses
import json
import re
from dataclasses import dataclass, make_dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from agents.algorithms import ALGORITHMS, algorithm, module_of
from agents.errors import UserError, check, check_choice, check_integers
from agents.lockstep.noise import stream_seed
from agents.training.checksums import write_files
from agents.training.environments import Spaces, Vectorization, is_native, module_of_task, spaces_of
from agents.training.files import compare, json_bytes, locked, read_json
from agents.training.machine import commit, made_with
from agents.training.memory import check_memory

Backend = Literal["compiled", "eager"]
Device = Literal["cpu", "cuda"]
FAILURE = "failed.json"
"""In the folder of a run that stopped at a NaN or an infinite number: its last step."""
TASK = re.compile(r"([\w.]+:)?([\w-]+/)?[\w:.-]+")
"""Ids of tasks, as gymnasium has them, with the module that registers them before."""
ALGORITHM = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*")
"""Names of algorithms: see `agents.algorithms.register`."""
CHECKPOINT, PREVIOUS = "checkpoint.npz", "checkpoint.previous.npz"
"""In the folder of the runs: the last checkpoint, and the one before it."""
NO_RUNS = "holds no runs: no config.json that circle2d train wrote"
NOT_SETTINGS = (
    *("versions", "machine", "resumed", "spaces", "commit"),
    *("algorithm_module", "task_module"),
)
"""Entries of config.json that are no fields of `TrainConfig`."""


class UnregisteredHyperparameters:
    """Base of the hyper-parameters, read from a file, of an algorithm that is not registered."""


@dataclass(frozen=True)
class TrainConfig:
    """Some runs of one algorithm on one task, which differ in their seed only."""

    algorithm: str
    task: str
    seeds: tuple[int, ...]
    steps: int
    """Environment steps of each run; the episode that reaches them is finished."""
    hyperparameters: Any
    """The algorithm's config; of an algorithm that is not registered, whose runs can only be
    reported, a dataclass of the same fields."""
    task_parameters: dict[str, Any] = dataclasses.field(default_factory=dict)
    """Keyword arguments for `gymnasium.make`."""
    checkpoint_every: int = 50_000
    """Environment steps of a run between checkpoints."""
    evaluate_every: int | None = None
    """Environment steps of a run between evaluations, which leave the policy too; None: never."""
    vectorization: Vectorization = "auto"
    """How environments run side by side: see `make_envs`."""
    step_timeout: float | None = None
    """Seconds that a step of environments in processes of their own may take; None: any."""
    tensorboard: bool = False
    """Whether to write TensorBoard event files too."""
    backend: Backend = "eager"
    """How updates run: as compiled code, or operation by operation. Results differ in their last
    bits, and so, in the end, in where chaos leads."""
    device: Device = "cpu"
    """Where updates run."""

    def __post_init__(self) -> None:
        if not isinstance(self.task, str) or not TASK.fullmatch(self.task):
            raise UserError(f"task must be the id of a gymnasium task, got {self.task!r}")
        if not isinstance(self.algorithm, str) or not ALGORITHM.fullmatch(self.algorithm):
            raise UserError(f"algorithm must be a name such as sac-lag, got {self.algorithm!r}")
        if not isinstance(self.task_parameters, dict):
            raise UserError(f"task_parameters must be values by name, got {self.task_parameters!r}")
        if not isinstance(self.tensorboard, bool):
            raise UserError(f"tensorboard must be True or False, got {self.tensorboard!r}")
        if self.step_timeout is not None:
            check(self, "step_timeout", above=0, high=86_400)
        if not isinstance(self.hyperparameters, UnregisteredHyperparameters):
            expected = algorithm(self.algorithm).config
            if type(self.hyperparameters) is not expected:
                raise UserError(
                    f"hyperparameters of {self.algorithm} must be a {expected.__name__}, "
                    f"got {self.hyperparameters!r}"
                )
        check_integers(self, "steps", "checkpoint_every", low=1)
        if self.evaluate_every is not None:
            check_integers(self, "evaluate_every", low=1)
        check_choice(self, "vectorization", *get_args(Vectorization))
        check_choice(self, "backend", *get_args(Backend))
        check_choice(self, "device", *get_args(Device))
        if not isinstance(self.seeds, tuple) or not all(type(seed) is int for seed in self.seeds):
            raise UserError(f"seeds must be a tuple of integers, got {self.seeds!r}")
        if not self.seeds or len(set(self.seeds)) < len(self.seeds):
            raise UserError(f"seeds must be different numbers, at least one, got {self.seeds}")
        if not all(0 <= seed < 2**63 for seed in self.seeds):
            raise UserError(f"seeds must be in [0, 2**63), got {self.seeds}")

    @property
    def stream_seeds(self) -> tuple[int, ...]:
        """Seeds of the random streams of each run: they depend on its seed and its task."""
        return tuple(stream_seed(seed, self.task) for seed in self.seeds)

    @property
    def is_native(self) -> bool:
        """Whether the task's own vector environment is used."""
        return self.vectorization == "auto" and is_native(self.task)

    @property
    def settings(self) -> dict[str, Any]:
        """Everything by name, the hyper-parameters one by one."""
        content = dataclasses.asdict(self)
        hyperparameters = content.pop("hyperparameters")
        return content | {f"hyperparameters.{k}": value for k, value in hyperparameters.items()}

    @property
    def shared(self) -> dict[str, Any]:
        """Settings that folders which train together have in common: all but tasks and seeds."""
        own = ("task", "task_parameters", "seeds")
        return {name: value for name, value in self.settings.items() if name not in own}

    def write(self, folder: Path) -> None:
        """Make the run folder.

        Raises UserError where there is one already, be it that another process makes it at the same
        time, where the task cannot be made, and where the runs need more than the machine's memory.
        """
        content = dataclasses.asdict(self) | made_with()
        content["commit"] = commit()
        content["algorithm_module"] = module_of(self.algorithm)
        content["task_module"] = module_of_task(self.task)  # "" of a built-in one
        spaces = spaces_of(self.task, self.task_parameters)
        check_memory(self.hyperparameters, len(self.seeds), spaces.sizes)
        self._check_scale(spaces.observation_size)
        content["spaces"] = spaces._asdict()
        for name in ("evaluate_every", "step_timeout"):
            if content[name] is None:
                del content[name]
        for name in ("task_parameters", "hyperparameters"):
            try:
                json.dumps(content[name])
            except (TypeError, ValueError, RecursionError) as error:
                raise UserError(f"{name} must be plain values: {error}") from None
        _require_none(folder)
        folder.mkdir(parents=True, exist_ok=True)
        with locked(folder):
            _require_none(folder)  # now that no other process can make it
            files: dict[str, bytes | None] = {}
            for seed in self.seeds:
                run_folder(folder, seed).mkdir(exist_ok=True)
                of_run = {"seed": seed} | {k: v for k, v in content.items() if k != "seeds"}
                files[f"{run_folder(folder, seed).name}/config.json"] = json_bytes(of_run)
            write_files(folder, files | {"config.json": json_bytes(content)})

    def _check_scale(self, observation_size: int) -> None:
        scale = getattr(self.hyperparameters, "input_scale", 1.0)
        if isinstance(scale, tuple) and len(scale) != observation_size:
            raise UserError(
                f"input_scale must be one number, or {observation_size}, as an observation of "
                f"{self.task} has, got {scale}"
            )

    @classmethod
    def read(cls, folder: Path, strict: bool = True) -> TrainConfig:
        """The configuration of a run folder: see `parse`. UserError where the file is missing, with
        folders of runs below, or does not match its checksum."""
        path = folder / "config.json"
        if not path.exists():
            raise UserError(_no_runs(folder))
        content, data = read_json(path), path.read_bytes()
        config = cls.parse(content, folder, strict)
        compare(path, data)
        return config

    @classmethod
    def parse(cls, content: dict[str, Any], folder: Path | str, strict: bool = True) -> TrainConfig:
        """The configuration that a `config.json` holds.

        folder: of the file, for errors. strict: require that the algorithm is registered; otherwise
        the hyper-parameters of one that is not are a plain frozen dataclass of the file's values,
        so that a report imports nothing. Raises UserError where the content is damaged.
        """
        if "seed" in content and "seeds" not in content:
            raise UserError(
                f"{folder} is the folder of one run: give the folder above it, and seed "
                f"{content['seed']} where one is asked for"
            )
        own = {name: content.get(name) for name in NOT_SETTINGS}
        content = {name: value for name, value in content.items() if name not in NOT_SETTINGS}
        try:
            values, name = _tuples(content.pop("hyperparameters")), content["algorithm"]
            if not isinstance(name, str):
                raise ValueError(f"algorithm must be a name, got {name!r}")
            content["seeds"] = tuple(content["seeds"])
            if name not in ALGORITHMS and strict and own["algorithm_module"]:
                how = "import {0} first (--import {0})".format(own["algorithm_module"])
                if own["algorithm_module"] == "__main__":
                    how = "register it in a module, not in a script"
                raise _Unregistered(f"algorithm {name!r} of {folder} is not registered here: {how}")
            known = strict or name in ALGORITHMS
            config = _of(algorithm(name).config, values) if known else _plain(values)
            return cls(hyperparameters=config, **content)
        except _Unregistered:
            raise
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            raise UserError(f"{folder}/config.json is damaged: {error}") from None


def _no_runs(folder: Path) -> str:
    """Words for a folder that holds no runs."""
    if not folder.exists():
        return f"{folder} is no folder"
    if any(folder.glob("seed-*/config.json")):
        return f"{folder / 'config.json'} is missing: the folder of runs is damaged"
    below = [*folder.glob("*/config.json")] or [*folder.glob("*/*/config.json")]  # as of a grid
    if below:
        names = ", ".join(f"'{path.parent}'" for path in sorted(below)[:3]) + ", ..." * (
            len(below) > 3
        )
        one_of = "one of " * (len(below) > 1)
        return f"{folder} holds folders of runs: did you mean {one_of}{names}?"
    return f"{folder} {NO_RUNS}"


def _require_none(folder: Path) -> None:
    if (folder / "config.json").exists():
        raise UserError(
            f"{folder} holds runs already: go on with them by 'circle2d resume {folder}' or "
            f"agents.resume({str(folder)!r}), or choose another folder"
        )


class _Unregistered(UserError):
    """The algorithm of a folder is not registered."""


def _of(kind: type, values: dict[str, Any]) -> Any:
    """Hyper-parameters of a class from those that a folder holds.

    One that it lacks is newer than its runs, and gets the default of the class that introduced it,
    which leaves training as it was; a subclass may have another default.
    """
    missing = {field.name for field in dataclasses.fields(kind)} - values.keys()
    for base in filter(dataclasses.is_dataclass, kind.__mro__):  # the last is the first to have it
        defaults = {field.name: field.default for field in dataclasses.fields(base)}
        found = {name: defaults[name] for name in missing & defaults.keys()}
        values |= {k: v for k, v in found.items() if v is not dataclasses.MISSING}
    return kind(**values)


def _plain(hyperparameters: dict[str, Any]) -> UnregisteredHyperparameters:
    """A frozen dataclass of values by name."""
    fields = [(name, Any) for name in hyperparameters]
    bases = (UnregisteredHyperparameters,)
    return make_dataclass("Hyperparameters", fields, bases=bases, frozen=True)(**hyperparameters)


def read_spaces(folder: Path, config: TrainConfig) -> Spaces:
    """Spaces of the task of a run folder, as they were when it was made.

    Folders of earlier versions do not hold them: there the task is asked. Raises UserError where it
    cannot be, or where the file is damaged.
    """
    path = folder / "config.json"
    content = read_json(path).get("spaces")
    if content is None:
        try:
            return spaces_of(config.task, config.task_parameters)
        except UserError as error:
            raise UserError(
                f"{path} does not hold the bounds of actions, as earlier versions left it, and the "
                f"task cannot tell them: {error}"
            ) from None
    try:
        low, high = (tuple(map(float, content[name])) for name in ("low", "high"))
        spaces = Spaces(int(content["observation_size"]), low, high, str(content["dtype"]))
        if len(low) != len(high) or not all(a < b for a, b in zip(low, high, strict=True)):
            raise ValueError(f"bounds of actions must be increasing, got {content}")
        return spaces
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise UserError(f"{path} is damaged: spaces: {error}") from None


def run_folder(folder: Path, seed: int) -> Path:
    """Folder of the files of one run."""
    return folder / f"seed-{seed}"


def run_folders(folder: Path, config: TrainConfig) -> list[Path]:
    """`run_folder` of each run."""
    return [run_folder(folder, seed) for seed in config.seeds]


def _tuples(parameters: dict[str, Any]) -> dict[str, Any]:
    return {k: tuple(v) if isinstance(v, list) else v for k, v in parameters.items()}
