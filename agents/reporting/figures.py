"""The figures of a report: what they show, as files, with the words below them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from agents.algorithms import ALGORITHMS
from agents.errors import UserError
from agents.paper import introduction as example
from agents.reporting.curves import Line, curves_svg
from agents.reporting.image_files import png
from agents.reporting.pictures import (
    ALPHA,
    PARTS,
    Episodes,
    caption,
    counts,
    episodes_by_seed,
    visits,
)
from agents.reporting.tables import title_of
from agents.results.reading import Group, Run
from agents.training.environments import circle2d_config
from circle2d_mj import Circle2DConfig
from circle2d_mj.circle2d.view import Circle2DView
from circle2d_mj.core.view import Picture
from circle2d_mj.render import canvas
from circle2d_mj.render.figure import figure

SIZE = 320
"""Pixels along the side of a picture in a figure."""
EPISODES = 5
"""Of each run's evaluation that are drawn."""
COLUMNS = 5
"""Runs of an algorithm whose episodes are drawn, at most."""


class Figure(NamedTuple):
    """A figure: a file, and its words."""

    name: str
    """Of the file"""
    content: bytes
    """PNG or SVG"""
    title: str
    caption: str


def introduction() -> list[Figure]:
    """The tasks and the metric, which are the same in every report on Circle2D."""
    config = Circle2DConfig()
    about_levels = (
        "Seen from above; the agent starts in the green area and is rewarded for being near the "
        "goal, the X. Grey: the cost region, where a step costs 1 and which level 0 does not let "
        f"in; its radius is {config.constraint_radius:g}, the arena {2 * config.arena:g} wide and "
        f"high, a step at most {config.full_step:g} along each axis. Circles: equal "
        "reward, a quarter of the radius apart."
    )
    picture, about_trajectories = example.two_trajectories(SIZE)
    return [
        Figure("levels.png", png(example.levels(SIZE)), "The four levels", about_levels),
        Figure("trajectories.png", png(picture), "Why EMCC", about_trajectories),
    ]


def figures(groups: Sequence[Group], notes: list[str]) -> list[Figure]:
    """The figures of one task: training curves; of Circle2D also where the agents were.

    groups: its runs. What cannot be drawn goes into the notes.
    """
    order = list(ALGORITHMS)
    groups = sorted(
        (group for group in groups if group.runs), key=lambda g: order.index(g.config.algorithm)
    )
    if not groups:
        return []
    drawn = [curves([(title_of(group.config), group) for group in groups])]
    if _task(groups[0]):
        drawn += [shown for shown in (_heatmaps(groups, notes), _trained(groups, notes)) if shown]
    return drawn


def _task(group: Group) -> Circle2DConfig | None:
    return circle2d_config(group.config.task, group.config.task_parameters)


def _row_title(group: Group) -> str:
    """The algorithm, and each of its settings that are not the preset's, in lines of their own."""
    return title_of(group.config).replace(" (", "\n(").replace(", ", ",\n")


def _file(kind: str, groups: Sequence[Group], suffix: str) -> str:
    return f"{kind}-{groups[0].config.task.replace('/', '-')}.{suffix}"


def curves(named: Sequence[tuple[str, Group]]) -> Figure:
    """Training curves of groups on one task, each with what it is called."""
    groups = [group for _, group in named]
    limits = {group.config.hyperparameters.cost_limit for group in groups}
    limit = limits.pop() if len(limits) == 1 else None
    lines = [
        Line(
            name,
            list(ALGORITHMS).index(group.config.algorithm),
            [run.records for run in group.runs],
            group.config.steps,
        )
        for name, group in named
    ]
    svg = curves_svg(groups[0].config.task, lines, limit, ALPHA)
    words = (
        "Of training's episodes. Lines: the mean over seeds; faint areas and bars: the standard "
        f"deviation. EMCC with α = {ALPHA:g}: of the rollouts in a window of a tenth of training "
        "around each point, and of the thirds of training, whose borders are dotted."
    )
    if limit is not None:
        words += f" Dashed: the cost limit, {limit:g}."
    return Figure(_file("curves", groups, "svg"), svg.encode(), "Training curves", words)


def _heatmaps(groups: Sequence[Group], notes: list[str]) -> Figure | None:
    """A row for each algorithm, a column for each third of training; one scale for all."""
    titles, captions, rows = [], [], []
    for group in groups:
        task = _task(group)
        assert task
        config = replace(group.config, seeds=tuple(run.seed for run in group.runs))
        try:
            parts = [visits(group.folder, config, part, ALPHA) for part in PARTS]
            rows.append((task, [counts(group.folder, task, part) for part in parts]))
        except UserError as error:
            notes.append(f"no heat map of {group.folder}: {error}")
            continue
        titles.append(_row_title(group))
        captions.append([caption(part) for part in parts])
    if not rows:
        return None
    most = canvas.most_visits([of_part for _, of_parts in rows for of_part in of_parts])
    pictures = []
    for task, of_parts in rows:
        view = Circle2DView(task)
        ground = view.background(SIZE)
        maps = [canvas.with_counts(ground, of_part, most) for of_part in of_parts]
        pictures.append([view.overlay(picture) for picture in maps])
    shown = figure(
        pictures, list(PARTS.values()), row_titles=titles, captions=captions, most_visits=most
    )
    words = (
        "States visited in the rollouts that dominate EMCC in each third of training (the share "
        f"α = {ALPHA:g} with the highest MCC, and all that equal the last of them), of all seeds "
        "together. One scale for all maps; its darkest colour stands for as many visits as 99 % of "
        "the visited cells do not exceed. EMCC: mean over seeds."
    )
    return Figure(_file("visited", groups, "png"), png(shown), "Visited states", words)


def _trained(groups: Sequence[Group], notes: list[str]) -> Figure | None:
    """A row for each algorithm, a column for each run."""
    titles, captions, pictures = [], [], []
    columns = min(COLUMNS, max(len(group.runs) for group in groups))
    for group in groups:
        task = _task(group)
        assert task
        try:
            played = episodes_by_seed(group.folder, EPISODES, noisy=False)
        except UserError as error:
            notes.append(f"no trajectories of {group.folder}: {error}")
            continue
        runs = [*group.runs, *[None] * columns][:columns]
        pictures.append([run and _of_run(played[run.seed], task) for run in runs])
        captions.append([_words(run) if run else "" for run in runs])
        titles.append(_row_title(group))
    if not pictures:
        return None
    shown = figure(pictures, [""] * columns, row_titles=titles, captions=captions)
    words = (
        f"The first {EPISODES} episodes of each trained policy's evaluation (deterministic), a "
        "dot for each state, orange where the step there cost. J_R, J_C: return and cost of an "
        "episode, means of the whole evaluation."
    )
    return Figure(_file("trained", groups, "png"), png(shown), "Trained policies", words)


def _of_run(played: Episodes | None, task: Circle2DConfig) -> Picture | None:
    if played is None:
        return None
    view = Circle2DView(task)
    ground, paths = view.background(SIZE), played.paths
    painted = canvas.with_trajectories(ground, view.extent, paths, played.costs, boxed=False)
    return view.overlay(painted)


def _words(run: Run) -> str:
    return f"seed {run.seed}: J_R {run.measures['J_R']:.1f}, J_C {run.measures['J_C']:.1f}"
