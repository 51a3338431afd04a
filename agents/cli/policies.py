"""`circle2d evaluate`, `render` and `export`: commands that use trained policies."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

import emcc
from agents.algorithms import title
from agents.checks import In, Settings
from agents.cli.options import (
    Folder,
    Folders,
    Imports,
    Size,
    Task,
    check_suffix,
    one_for_each,
    parse,
)
from agents.cli.training import name_failures
from agents.errors import UserError
from agents.export import Format
from agents.export import export as write_export
from agents.reporting import pictures
from agents.reporting.table import working
from agents.training import derive, evaluation, policy, trainer
from agents.training.config import TrainConfig
from agents.training.environments import time_limit
from agents.training.files import locked, remove_unfinished
from circle2d_mj.circle2d.config import Camera
from circle2d_mj.registration import PHYSICS
from emcc.statistics import FEWEST_RUNS


def _means_over(episodes: int) -> str:
    intervals = "95 % t intervals" if episodes >= FEWEST_RUNS else "ranges"
    return f"means over {episodes} episodes, with {intervals}"


def _mean(values: NDArray[np.float64]) -> str:
    """Return the mean over episodes with its interval, or the range of few episodes."""
    mean = emcc.mean_interval(values.ravel())
    if mean.kind == "t":
        return f"{mean.value:.2f} [{mean.low:.2f}, {mean.high:.2f}]"
    words = "" if mean.low is None else f" ({mean.low:.2f} to {mean.high:.2f})"
    return f"{mean.value:.2f}{words}"


@dataclass(frozen=True)
class EvaluateOptions(Settings):
    """Play episodes with the policies of a folder's newest checkpoint and print their means. If the
    training is done, they replace the evaluation that reports show."""

    folder: Folder
    """Folder of the runs, or pretrained:ALGORITHM/TASK, a policy that comes with the package."""
    episodes: Annotated[int, In(1, 1_000_000)] | None = None
    """Episodes of each run and policy (deterministic, stochastic); by default as many as the
    training's own evaluation has."""
    imports: Imports = ()


def evaluate(args: Sequence[str]) -> int:
    """Run `circle2d evaluate`; return the exit status."""
    options = parse(EvaluateOptions, "evaluate", args)
    folder = policy.folder_of(options.folder)
    config = TrainConfig.read(folder)
    if options.episodes is not None:
        config = replace(config, evaluation_episodes=options.episodes)
    episodes = config.evaluation_episodes
    if folder != options.folder:  # a policy from the package: nothing is written
        print(f"{options.folder}: {_means_over(episodes)}")
        for name in evaluation.POLICIES:
            with working(f"playing {episodes} episodes"):
                found = policy.evaluate(folder, None, episodes, name == "deterministic")
            words = f"J_R {_mean(found.returns)}, J_C {_mean(found.costs)}"
            print(f"{config.runs[0]}, {name} policy: {words}")
        return 0
    folder = folder.absolute()  # a task may change the current one
    with locked(folder), working(f"playing {episodes} episodes of each run with either policy"):
        remove_unfinished(folder)
        trained = trainer.Trainer(folder, config)
        trained.load()
        trainer.check_unchanged(folder, config)
        act, going = trained.learner.policy(), trained.failures == ""
        if trained.done:
            why = (trained.failures, trained.tracebacks)
            results = derive.write_results(folder, config, act, *why, episodes)
        else:
            results = evaluation.evaluate_runs(config, act, episodes, going)
    taken = trained.steps[going] if going.any() else trained.steps
    asked = "" if trained.done else f" of {config.steps}"
    done = f"after {taken.min()}{asked} steps"
    print(f"{options.folder}, {done}: {_means_over(episodes)}")
    for name, result in results.items():
        for k, run in enumerate(config.runs):
            words = trained.failures[k] or result.why(k)
            if not result.void[k]:
                words = f"J_R {_mean(result.returns[k])}"
                for cost, of_episodes in zip(config.costs, result.costs[k].T, strict=True):
                    words += f", J_C {_mean(of_episodes)}" + f" ({cost})" * (cost != "cost")
            print(f"{run}, {name} policy: {words}")
    return (
        name_failures([(folder, config)])
        if trained.done
        else int(any(r.void.any() for r in results.values()))
    )


PICTURES = 200
"""Most pictures of an episode in a film, unless `--every` is given."""


@dataclass(frozen=True)
class RenderOptions(Settings):
    """Draw episodes of trained policies: all in one picture (.png), or as a film (.gif, .mp4).

    Several folders are drawn side by side, each with its name and what it has cost so far.
    """

    folders: Folders
    """Folders of runs on tasks that offer a view or, for films, frames of their own;
    pretrained:ALGORITHM/TASK is a policy that comes with the package."""
    out: Path | None = None
    """File to write; its suffix decides the format. By default trajectories.png, or film.gif with
    --frames mujoco, in the first folder, or in the current one for a policy of the package."""
    episodes: int | None = None
    """Number of episodes to draw, the first of the evaluation; by default 3, or all if fewer."""
    task: Task = None
    seed: tuple[int, ...] | None = None
    """Seed of the run: one for all folders, or one for each; by default a folder's first."""
    names: tuple[str, ...] = ()
    """Titles above the panels, one for each folder; by default the algorithm and the seed."""
    stochastic: bool = False
    """Draw the stochastic policy instead of the deterministic one."""
    frames: Literal["map", "mujoco"] = "map"
    """map: the trajectory in the task's view, a plane of positions, distances or speeds. mujoco:
    films of the task as MuJoCo renders it."""
    camera: Camera | None = None
    """Camera for a Circle2DMuJoCo task with --frames mujoco: above (the default), at the side, or
    behind the agent."""
    every: Annotated[int, In(1)] | None = None
    """Steps from one picture of a film to the next; by default the fewest that show an episode in
    200 pictures, 20 seconds."""
    size: Size = 640
    imports: Imports = ()


def render(args: Sequence[str]) -> int:
    """Run `circle2d render`; return the exit status."""
    options = parse(RenderOptions, "render", args)
    folders = [policy.folder_of(given) for given in options.folders]
    if not folders:
        raise UserError("render needs a folder of runs")
    names = one_for_each("names", options.names, folders)
    given = options.seed or ()
    seeds = one_for_each("seed", given * len(folders) if len(given) == 1 else given, folders)
    beside = folders[0] if folders[0] == options.folders[0] else Path()
    by_mujoco = options.frames == "mujoco"
    out = options.out or beside / ("film.gif" if by_mujoco else "trajectories.png")
    check_suffix(out, *[".png"] * (not by_mujoco), ".gif", ".mp4")
    if options.camera and not by_mujoco:
        raise UserError("camera needs --frames mujoco: the map has no camera")
    if options.every is not None and out.suffix.lower() == ".png":
        raise UserError(f"every is for films: give --out a .gif or .mp4, got {str(out)!r}")
    configs = [TrainConfig.read(folder) for folder in folders]
    runs = [
        policy.chosen_run(folder, config, config.seeds[0] if seed is None else seed, options.task)
        for folder, config, seed in zip(folders, configs, seeds, strict=True)
    ]
    parameters = [config.task_parameters for config in configs]
    limits = [time_limit(run.task, of_run) for run, of_run in zip(runs, parameters, strict=True)]
    every = options.every or max(math.ceil((limit or 1) / PICTURES) for limit in limits)
    panels = []
    for folder, config, run, name in zip(folders, configs, runs, names, strict=True):
        camera = camera_of(run.task, options.camera) if by_mujoco else None
        episodes = options.episodes
        if episodes is None:
            episodes = min(3, config.evaluation_episodes)
        shown, view = pictures.evaluation_episodes(
            folder,
            run,
            episodes,
            noisy=options.stochastic,
            own_frames=by_mujoco,
            camera=camera,
            every=every,
        )
        heading = name or f"{title(config.algorithm)}, seed {run.seed}"
        panels.append(pictures.Panel(heading, view, shown))
    if out.suffix.lower() == ".png":
        pictures.write_picture(out, pictures.picture(panels, options.size))
    else:
        frames = pictures.film(panels, options.size, every)
        pictures.write_film(out, frames, pictures.pictures_of(panels, every))
    print(out)
    return 0


def camera_of(task: str, chosen: Camera | None) -> Camera | None:
    """Return the camera for frames from MuJoCo; None for a task with only one. Raises UserError if
    a camera is chosen for such a task."""
    if task.rpartition(":")[2] in PHYSICS.values():
        return chosen or "top"
    if chosen:
        raise UserError(f"camera is for {', '.join(PHYSICS.values())}: {task!r} has one, its own")
    return None


@dataclass(frozen=True)
class ExportOptions:
    """Write trained policies, without exploration noise, as files for other programs, and a model
    card. Needs the extra [export]."""

    folder: Folder
    """Folder of the runs, or pretrained:ALGORITHM/TASK."""
    format: Format
    """safetensors: the network's arrays; onnx: a graph from observations to actions."""
    out: Path | None = None
    """Folder for the files; by default `exported` in the runs' folder, with a subfolder for the
    task if there are several. Required for a policy that comes with the package."""
    seeds: tuple[int, ...] | None = None
    """Seeds of the runs to export; by default all."""
    task: Task = None
    step: int | None = None
    """Environment steps after which the training saved the policy, a multiple of its
    --evaluate-every; by default the policy of the newest checkpoint."""
    imports: Imports = ()


def export(args: Sequence[str]) -> int:
    """Run `circle2d export`; return the exit status."""
    options = parse(ExportOptions, "export", args)
    folder = policy.folder_of(options.folder)
    if folder != options.folder and options.out is None:
        raise UserError(f"{options.folder} is in the package: give a folder for the files, --out")
    written = write_export(
        folder,
        options.format,
        options.out,
        seeds=options.seeds,
        step=options.step,
        task=options.task,
    )
    for path in written:
        print(path)
    return 0
