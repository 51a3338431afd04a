"""What is trained: written once into the run folder, and read by everything after."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from agents.algorithms import algorithm
from agents.errors import UserError, check_choice, check_integers
from agents.lockstep.noise import stream_seed
from agents.training.environments import Vectorization, is_native, sizes_of
from agents.training.files import read_json, write_json
from agents.training.machine import made_with

Backend = Literal["compiled", "eager"]
Device = Literal["cpu", "cuda"]
FAILURE = "failed.json"
"""In the folder of a run that stopped at a number which is not finite: the step it had come to."""


@dataclass(frozen=True)
class TrainConfig:
    """Some runs of one algorithm on one task, which differ in their seed only."""

    algorithm: str
    task: str
    seeds: tuple[int, ...]
    steps: int
    """Environment steps of each run; the episode that reaches them is finished."""
    hyperparameters: Any
    """The algorithm's config."""
    task_parameters: dict[str, Any] = dataclasses.field(default_factory=dict)
    """Keyword arguments for `gymnasium.make`."""
    checkpoint_every: int = 50_000
    """Environment steps of a run between checkpoints."""
    vectorization: Vectorization = "auto"
    """How environments run side by side: see `make_envs`."""
    tensorboard: bool = False
    """Whether to write TensorBoard event files too."""
    backend: Backend = "eager"
    """How updates run: as compiled code, or operation by operation. Results differ in their last
    bits, and so, in the end, in where chaos leads."""
    device: Device = "cpu"
    """Where updates run."""

    def __post_init__(self) -> None:
        expected = algorithm(self.algorithm).config
        if type(self.hyperparameters) is not expected:
            raise UserError(
                f"hyperparameters of {self.algorithm} must be a {expected.__name__}, "
                f"got {self.hyperparameters!r}"
            )
        check_integers(self, "steps", "checkpoint_every", low=1)
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
        """What folders whose runs train together have in common: all but tasks and seeds."""
        own = ("task", "task_parameters", "seeds")
        return {name: value for name, value in self.settings.items() if name not in own}

    def write(self, folder: Path) -> None:
        """Make the run folder. Raises UserError where there is one already."""
        if (folder / "config.json").exists():
            raise UserError(
                f"{folder} holds runs already: go on with them by 'circle2d resume {folder}', "
                "or choose another folder"
            )
        content = dataclasses.asdict(self) | made_with()
        try:
            json.dumps(content)
        except TypeError as error:
            raise UserError(f"task_parameters must be plain values: {error}") from None
        folder.mkdir(parents=True, exist_ok=True)
        for seed in self.seeds:
            run_folder(folder, seed).mkdir(exist_ok=True)
            of_run = {"seed": seed} | {k: v for k, v in content.items() if k != "seeds"}
            write_json(run_folder(folder, seed) / "config.json", of_run)
        write_json(folder / "config.json", content)

    @classmethod
    def read(cls, folder: Path) -> TrainConfig:
        """The configuration of a run folder. Raises UserError where it is missing or damaged."""
        path = folder / "config.json"
        return cls.parse(read_json(path), path)

    @classmethod
    def parse(cls, content: dict[str, Any], path: Path | str) -> TrainConfig:
        """The configuration that a `config.json` holds.

        path: of the file, for the UserError where the content is damaged.
        """
        content = {k: v for k, v in content.items() if k not in ("versions", "machine", "resumed")}
        try:
            hyperparameters = _tuples(content.pop("hyperparameters"))
            content["seeds"] = tuple(content["seeds"])
            config = algorithm(content["algorithm"]).config(**hyperparameters)
            return cls(hyperparameters=config, **content)
        except (KeyError, TypeError, ValueError) as error:
            raise UserError(f"{path} is damaged: {error}") from None


def check_together(configs: dict[Path, TrainConfig]) -> None:
    """Raise UserError where folders cannot train together."""
    found: dict[str, tuple[Path, Any]] = {}
    for folder, config in configs.items():
        sizes = sizes_of(config.task, config.task_parameters)
        of_task = dict(zip(("observation size", "action size"), sizes, strict=True))
        for name, value in (config.shared | of_task).items():
            first, expected = found.setdefault(name, (folder, value))
            if value != expected:
                raise UserError(
                    f"folders that train together must have equal settings: {name} is {expected} "
                    f"in {first}, {value} in {folder}"
                )


def run_folder(folder: Path, seed: int) -> Path:
    """Where the files of one run are."""
    return folder / f"seed-{seed}"


def run_folders(folder: Path, config: TrainConfig) -> list[Path]:
    """`run_folder` of each run."""
    return [run_folder(folder, seed) for seed in config.seeds]


def _tuples(parameters: dict[str, Any]) -> dict[str, Any]:
    return {k: tuple(v) if isinstance(v, list) else v for k, v in parameters.items()}
