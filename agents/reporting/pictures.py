"""Pictures and films on demand: heat maps of training and episodes of trained policies."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import VectorEnv, VectorWrapper
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageOps

from agents.errors import OWN_ERRORS, TaskFailure, UserError
from agents.lockstep.rollout import Rollout
from agents.reporting.maps import Ground, HeatColumn, heat_figure, png
from agents.results.groups import Episode
from agents.results.names import title_of
from agents.results.reading import results_of, run_records
from agents.training.config import RunId, TrainConfig
from agents.training.derive import Steps, count_visits, told_steps
from agents.training.environments import make_envs, registered, view_of
from agents.training.evaluation import paths_of, play, runs_envs
from agents.training.files import check_file, whole, write_whole
from agents.training.policy import chosen_run, load_policy
from circle2d_mj.core.view import Picture, View
from circle2d_mj.render import canvas
from circle2d_mj.render.figure import figure
from emcc import longest_streak
from emcc.parts import PARTS

CELLS = 160
"""Cells along each side of a heat map."""
SIZE = 640
"""Default pixels along the side of a map."""
HELD = 8
"""Number of further pictures for which an episode's last one stays."""
FRAMES_A_SECOND = 10
"""Frame rate of films: a step of the task takes 0.1 s."""


def heatmap(
    folders: Sequence[Path],
    parts: Sequence[float],
    alpha: float,
    size: int = SIZE,
    seeds: tuple[int, ...] | None = None,
    names: Sequence[str | None] | None = None,
    task: str | None = None,
) -> Picture:
    """Draw heat maps of parts of training with one scale: [height, width, 3].

    For a single folder, the parts are side by side; several folders are columns, and parts are
    rows. folders: of one algorithm each. parts and alpha: see `derive.count_visits`; size: pixels
    along the side of each map. seeds: whose runs are taken together, by default all that have not
    failed. names: titles of the folders; by default the algorithm, its settings and the task, and
    the seeds unless all are shown. task: the one to show, if a folder has several. Raises UserError
    for a folder without positions, and for a seed that is not among the runs.
    """
    names = names or [None] * len(folders)
    columns = [
        _column(folder, parts, alpha, seeds, name, task)
        for folder, name in zip(folders, names, strict=True)
    ]
    return heat_figure(columns, [f"{PARTS[part]} of training" for part in parts], size)


def _column(
    folder: Path,
    parts: Sequence[float],
    alpha: float,
    seeds: tuple[int, ...] | None,
    name: str | None,
    task: str | None,
) -> HeatColumn:
    config = TrainConfig.read(folder)
    task = chosen_run(folder, config, config.seeds[0], task).task
    view, arrays, steps = _view(config, task), results_of(folder, config), Steps(folder)
    if seeds is None:
        ids = {seed: RunId(task, seed) for seed in config.seeds}
        seeds = tuple(seed for seed, run in ids.items() if run.prefix + "failure" not in arrays)
    if not seeds or not set(seeds) <= set(config.seeds):
        raise UserError(f"seeds must be among {list(config.seeds)}, not failed, got {list(seeds)}")
    runs = []
    for run in (RunId(task, seed) for seed in seeds):
        positions = steps.get(run, "positions")
        if positions is None:
            raise UserError(f"{folder} has no positions of {run}")
        runs.append((run_records(arrays, run, config.costs[0]), positions))
    taken = told_steps(config.steps, (records.total_steps for records, _ in runs))
    heading = name or f"{title_of(config, task, steps=taken)} on {task}"
    if name is None and set(seeds) != set(config.seeds):
        heading += f" (seeds: {', '.join(map(str, seeds))})"
    visits = count_visits(view, runs, config.steps, parts, alpha, CELLS)
    return HeatColumn(heading, [view] * len(parts), visits)


def _view(config: TrainConfig, task: str) -> View:
    view = view_of(task, config.task_parameters)
    if view is None:
        raise UserError(f"task {task!r} has no positions to draw: it offers no view")
    return view


def evaluation_episodes(
    folder: Path,
    run: RunId,
    episodes: int,
    noisy: bool,
    own_frames: bool = False,
    camera: str | None = None,
    every: int = 1,
) -> tuple[list[Episode] | list[Filmed], View | None]:
    """Play the first evaluation episodes of a run again; return them and the view of the task.

    Without a view, or with own_frames, the episodes are filmed by the task itself and the view is
    None. noisy: whether to play the stochastic policy. camera: the one to film with, if the task
    has several; every: steps from one frame to the next. Raises UserError for a task with neither
    view nor frames, and for a policy whose actions are not finite.
    """
    config = TrainConfig.read(folder)
    evaluated = config.evaluation_episodes
    if not 1 <= episodes <= evaluated:
        raise UserError(f"episodes must be in [1, {evaluated}], as evaluated, got {episodes}")
    alone = replace(config, tasks=(run.task,), seeds=(run.seed,))
    policy = load_policy(folder, run.seed, task=run.task).in_lockstep
    view = view_of(run.task, config.task_parameters)

    def played(envs: VectorEnv) -> Rollout:
        rollout = play(envs, alone, policy, evaluated, 0, episodes, np.ones(1, bool), noisy)
        for cause in filter(None, rollout.failure):
            if isinstance(cause, TaskFailure):
                raise cause
            raise UserError(f"the policy of {run} returns numbers that are not finite")
        return rollout

    if camera is not None:
        alone = replace(alone, task_parameters=alone.task_parameters | {"camera": camera})
    if view is None or own_frames:
        return film_episodes(alone, episodes, played, every), None
    with contextlib.closing(runs_envs(alone, episodes)) as envs:
        [paths] = paths_of(envs, played(envs), 1, episodes)
    return [Episode(positions, costs) for positions, costs in paths], view


@dataclass(frozen=True)
class Panel:
    """Episodes of one policy, in the order in which a film shows them."""

    title: str
    view: View | None
    """None for episodes that the task itself renders."""
    episodes: Sequence[Episode | Filmed]


def picture(panels: Sequence[Panel], size: int) -> Picture:
    """Draw all episodes of each panel in one picture, with streaks of cost steps boxed.

    Returns [height, width, 3]. size: pixels along each side of a panel. Raises UserError for a
    panel without a view.
    """
    drawn = []
    for panel in panels:
        if panel.view is None:
            raise UserError(
                f"the task of {panel.title!r} offers no view to draw whole episodes on: give --out "
                "a film, .gif or .mp4"
            )
        episodes = [episode for episode in panel.episodes if isinstance(episode, Episode)]
        ground = Ground(panel.view, panel.view.background(size))
        drawn.append(ground.trajectories(episodes, True))
    captions = [[f"mean cost {np.mean([e.costs.sum() for e in p.episodes]):.1f}" for p in panels]]
    return figure([drawn], [panel.title for panel in panels], captions=captions)


def film(panels: Sequence[Panel], size: int, every: int = 1) -> Iterator[Picture]:
    """Yield a picture [height, width, 3] for each shown state, with the path that led to the state.

    Episodes follow each other; those of all panels play at the same time, and an episode that is
    over waits for the others. size: pixels along each side of a panel; height and width are even,
    as video requires. every: steps from one picture to the next.
    """
    grounds = [Ground(p.view, p.view.background(size)) if p.view else None for p in panels]
    for number, episodes in enumerate(zip(*(p.episodes for p in panels), strict=True), 1):
        for step in _shown(episodes, every):
            shown = [min(step, len(episode.costs)) for episode in episodes]
            drawn = [
                _state(ground, episode, k, size, every)
                for ground, episode, k in zip(grounds, episodes, shown, strict=True)
            ]
            words = [_words(number, e, k) for e, k in zip(episodes, shown, strict=True)]
            yield _even(figure([drawn], [panel.title for panel in panels], captions=[words]))


def pictures_of(panels: Sequence[Panel], every: int = 1) -> int:
    """Return the number of pictures of a film."""
    together = zip(*(panel.episodes for panel in panels), strict=True)
    return sum(len(_shown(episodes, every)) for episodes in together)


def _shown(episodes: Sequence[Episode | Filmed], every: int) -> list[int]:
    """Return the steps taken before each picture, for episodes that are shown together."""
    longest = max(len(episode.costs) for episode in episodes)
    return [*range(0, longest, every), *[longest] * (1 + HELD)]


def _words(number: int, episode: Episode | Filmed, steps: int) -> str:
    """Return the caption of an episode after some steps: number, step, cost, longest streak."""
    costs = episode.costs[:steps]
    streak = longest_streak(costs) if steps else 0
    return f"episode {number}, step {steps}: cost {costs.sum():g}, longest streak {streak}"


def _state(
    ground: Ground | None, episode: Episode | Filmed, steps: int, size: int, every: int
) -> Picture:
    """Draw the task after some steps of an episode: the path and a disc for the agent; or the
    task's own frame, centred, with a border if one of the last `every` steps cost."""
    if isinstance(episode, Filmed):
        with Image.open(io.BytesIO(episode.frames[steps])) as frame:
            image = ImageOps.pad(frame, (size, size), color=(255, 255, 255))
        if (episode.costs[max(steps - every, 0) : steps] > 0).any():
            edges = (0, 0, size - 1, size - 1)
            ImageDraw.Draw(image).rectangle(edges, outline=canvas.BOX, width=max(size // 60, 2))
        return np.asarray(image)
    assert ground is not None
    view, path = ground.view, episode.positions
    way, costs = path[: steps + 1], episode.costs[:steps]
    painted = canvas.with_trajectories(ground.background, view.extent, [way], [costs])
    return canvas.with_agent(view.overlay(painted), view.extent, path[steps])


def _even(picture: Picture) -> Picture:
    """Crop the last row or column of a picture with an odd number of them."""
    height, width, _ = picture.shape
    return picture[: height - height % 2, : width - width % 2]


def write_picture(path: Path, picture: Picture) -> None:
    """Write a PNG; an error leaves no partial file."""
    _prepare(path)
    write_whole(path, png(picture))


def _few_colours(picture: Picture) -> Image.Image:
    """Reduce the colours of a picture for a GIF, which is then half as large."""
    octree = Image.Quantize.FASTOCTREE  # five times as fast as the default
    return Image.fromarray(picture).quantize(64, octree, dither=Image.Dither.NONE)


def write_film(path: Path, frames: Iterable[Picture], total: int) -> None:
    """Write `total` frames to a .gif or .mp4 file, showing progress; an error leaves no file."""
    import imageio.v2 as imageio
    from rich.console import Console
    from rich.progress import track

    _prepare(path)
    shown = track(frames, "drawing", total, console=Console(stderr=True), transient=True)
    with whole(path) as file:
        if path.suffix.lower() == ".gif":
            first, *others = map(_few_colours, shown)
            timing = {"duration": 1000 // FRAMES_A_SECOND, "loop": 0}
            first.save(file, "GIF", save_all=True, append_images=others, **timing)
            return
        # Sizes are even; without this option they would be changed to multiples of 16.
        how: Any = {"format": ".mp4", "fps": FRAMES_A_SECOND, "macro_block_size": 2}
        writer: Any = imageio.get_writer(file, **how)  # pyright: ignore[reportArgumentType]
        with writer:
            for frame in shown:
                writer.append_data(frame)


def _prepare(path: Path) -> None:
    check_file(path)
    path.parent.mkdir(parents=True, exist_ok=True)


class Filmed(NamedTuple):
    """An episode as the task itself renders it."""

    frames: Mapping[int, bytes]
    """States as PNG files by number of steps taken before, with start and end; raw pixels would
    fill the memory."""
    costs: NDArray[np.float64]
    """[T]"""


def film_episodes(
    config: TrainConfig, episodes: int, played: Callable[[VectorEnv], Rollout], every: int = 1
) -> list[Filmed]:
    """Film episodes of one run as its task renders them.

    config: reduced to the run; played: plays the episodes in the given environments; every: steps
    from one frame to the next. Raises UserError for a task without frames.
    """
    [task] = config.tasks
    parameters = config.task_parameters | {"render_mode": "rgb_array"}
    try:
        made = make_envs(registered(task), episodes, parameters, "sync", costs=config.task_costs)
    except UserError as error:
        raise _without_frames(task, error) from error
    with contextlib.closing(_KeepFrames(made, task, every)) as envs:
        rollout, frames = played(config.wrap(envs, task)), envs.frames
    costs = rollout.cost[..., 0].astype(np.float64)
    return [
        Filmed({n: state[k] for n, state in frames.items() if n <= steps}, costs[:steps, k])
        for k, steps in enumerate(rollout.length)
    ]


class _KeepFrames(VectorWrapper):
    """Wrapper that keeps frames of every environment since the last reset of all of them: at the
    start, at every `every`-th step, and where an episode ends."""

    def __init__(self, env: VectorEnv, task: str, every: int) -> None:
        super().__init__(env)
        self._task, self._every, self._steps = task, every, 0
        self.frames: dict[int, list[bytes]] = {}

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        found = self.env.reset(seed=seed, options=options)
        if options is None or "reset_mask" not in options:
            self._steps, self.frames = 0, {0: self._render()}
        return found

    def step(self, actions: Any) -> tuple[Any, NDArray, NDArray, NDArray, dict[str, Any]]:
        found = self.env.step(actions)
        self._steps += 1
        if self._steps % self._every == 0 or np.logical_or(*found[2:4]).any():
            self.frames[self._steps] = self._render()
        return found

    def _render(self) -> list[bytes]:
        envs: Any = self.unwrapped
        try:
            frames = [np.asarray(env.render(), np.uint8) for env in envs.envs]
            return [png(frame, optimize=False, compress_level=1) for frame in frames]
        except OWN_ERRORS as error:  # raised by the task's own code
            raise _without_frames(self._task, error) from error


def _without_frames(task: str, error: BaseException) -> UserError:
    return UserError(f"task {task!r} gives no frames with render_mode 'rgb_array': {error}")
