"""The figures of a report: picture files, with the words below them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple

from agents.algorithms import title
from agents.errors import UserError
from agents.paper import introduction as example
from agents.paper.settings import cost_limit, differences, in_order, title_of
from agents.reporting.curves import Line, curves_svg
from agents.reporting.image_files import png
from agents.reporting.style import styles
from agents.results.measures import measure
from agents.results.reading import Group, Run
from agents.results.source import DamagedSource, Source
from agents.results.statistics import INTERVALS
from agents.results.steps import DRAWN, Episode, Visits
from agents.training.environments import view_of
from circle2d_mj.core.view import Picture, View
from circle2d_mj.render import canvas
from circle2d_mj.render.figure import figure
from emcc.parts import ALPHA, PARTS

SIZE = 320
"""Pixels along the side of a picture in a figure."""
COLUMNS = 5
"""Runs of an algorithm whose episodes are drawn, at most."""


class Figure(NamedTuple):
    """A picture file and its words."""

    name: str
    """Of the file, without its suffix."""
    kind: Literal["png", "svg"]
    content: bytes
    title: str
    caption: str

    @property
    def file(self) -> str:
        """The file's name."""
        return f"{self.name}.{self.kind}"


class Ground(NamedTuple):
    """A task's view with its background, to draw on."""

    view: View
    background: Picture

    def heatmap(self, visits: Visits, most: int) -> Picture:
        """Visited states. most: visits of the last colour."""
        return self.view.overlay(canvas.with_counts(self.background, visits.counts, most))

    def trajectories(self, episodes: Sequence[Episode], boxed: bool) -> Picture:
        """Episodes, a dot for each state. boxed: see `canvas.with_trajectories`."""
        paths, costs = zip(*episodes, strict=True)
        extent = self.view.extent
        picture = canvas.with_trajectories(self.background, extent, paths, costs, boxed=boxed)
        return self.view.overlay(picture)


def introduction() -> list[Figure]:
    """The tasks and the metric, which are the same in every report on Circle2D."""
    picture, about_trajectories = example.two_trajectories(SIZE)
    levels = png(example.levels(SIZE))
    return [
        Figure("levels", "png", levels, "The four levels", example.about_levels()),
        Figure("trajectories", "png", png(picture), "Why EMCC", about_trajectories),
    ]


def figures(source: Source, groups: Sequence[Group], notes: list[str]) -> list[Figure]:
    """The figures of one task: training curves; of a task that offers a view also where the agents
    were.

    groups: its runs. What cannot be drawn goes into the notes.
    """
    groups = [group for group in in_order(groups) if group.runs]
    if not groups:
        return []
    drawn: list[Figure | None] = [curves([(title_of(group.config), group) for group in groups])]
    grounds = {}  # painted once for equal tasks
    for config in (group.config for group in groups):
        if repr(config.task_parameters) not in grounds:
            view = view_of(config.task, config.task_parameters)
            grounds[repr(config.task_parameters)] = view and Ground(view, view.background(SIZE))
    seen = [(group, on) for group in groups if (on := grounds[repr(group.config.task_parameters)])]
    if seen:
        drawn += [_heatmaps(source, seen, notes), _trained(source, seen, notes)]
    return [shown for shown in drawn if shown]


def _row_title(group: Group) -> str:
    """The algorithm, and each of its settings that are not the preset's, in lines of their own."""
    name, settings = title(group.config.algorithm), ",\n".join(differences(group.config))
    return f"{name}\n({settings})" if settings else name


def _file(kind: str, group: Group) -> str:
    return f"{kind}-{group.config.task.replace('/', '-')}"


def curves(named: Sequence[tuple[str, Group]]) -> Figure:
    """Training curves of groups on one task, each with its name."""
    groups = [group for _, group in named]
    limits = {cost_limit(group.config) for group in groups}
    limit = limits.pop() if len(limits) == 1 else None
    lines = []
    for (name, group), style in zip(named, styles([g.config for g in groups]), strict=True):
        records = [run.records for run in group.runs]
        lines.append(Line(name, style, records, group.config.steps, group.one_place))
    svg = curves_svg(groups[0].config.task, lines, limit, ALPHA)
    words = (
        f"Of training's episodes. Lines and markers: the mean over seeds. Faint areas and bars: "
        f"{INTERVALS}, at each point; of costs and EMCC they are cut off at 0. EMCC with "
        f"α = {ALPHA:g}: of the rollouts in a window of a tenth of training around each point, and "
        "of the thirds of training, whose borders are dotted."
    )
    if limit is not None:
        words += f" Thin line: the cost limit, {limit:g}."
    return Figure(_file("curves", groups[0]), "svg", svg, "Training curves", words)


def _heatmaps(
    source: Source, seen: Sequence[tuple[Group, Ground]], notes: list[str]
) -> Figure | None:
    """A row for each algorithm, a column for each third of training; one scale for all."""
    titles, captions, rows = [], [], []
    for group, ground in seen:
        records = {run.seed: run.records for run in group.runs}
        try:
            parts = source.visits(group.folder, group.config, records)
        except DamagedSource:
            raise
        except UserError as error:
            notes.append(f"no heat map of {source.title(group.folder)}: {error}")
            continue
        rows.append((ground, parts))
        titles.append(_row_title(group))
        captions.append([visits_words(part) for part in parts])
    if not rows:
        return None
    most = canvas.most_visits([part.counts for _, parts in rows for part in parts])
    shown = figure(
        [[ground.heatmap(part, most) for part in parts] for ground, parts in rows],
        [f"{words} of training" for words in PARTS.values()],
        row_titles=titles,
        captions=captions,
        most_visits=most,
    )
    words = (
        "States visited in the rollouts that dominate EMCC in each third of training (the share "
        f"α = {ALPHA:g} with the highest MCC, and all that equal the last of them), of all seeds "
        "together. One scale for all maps; its darkest colour stands for as many visits as 99 % of "
        "the visited cells do not exceed. EMCC: mean over seeds."
    )
    return Figure(_file("visited", seen[0][0]), "png", png(shown), "Visited states", words)


def visits_words(visits: Visits) -> str:
    """The line below a heat map."""
    return f"EMCC {visits.emcc:.2f} ({visits.rollouts:,} of {visits.of:,} rollouts)"


def _trained(
    source: Source, seen: Sequence[tuple[Group, Ground]], notes: list[str]
) -> Figure | None:
    """A row for each algorithm, a column for each run."""
    titles, captions, pictures = [], [], []
    columns = min(COLUMNS, max(len(group.runs) for group, _ in seen))
    for group, ground in seen:
        try:
            played = source.trained(group.folder, group.config, group.seeds)
        except DamagedSource:
            raise
        except UserError as error:
            notes.append(f"no trajectories of {source.title(group.folder)}: {error}")
            continue
        shown = group.runs[:columns]
        gaps = [None] * (columns - len(shown))
        episodes = [played[run.seed] for run in shown]  # None of a policy that diverged
        drawn = [of and ground.trajectories(of, boxed=False) for of in episodes]
        pictures.append([*drawn, *gaps])
        captions.append([*map(_words, shown), *[""] * len(gaps)])
        titles.append(_row_title(group))
    if not any(picture is not None for row in pictures for picture in row):
        return None
    content = png(figure(pictures, [""] * columns, row_titles=titles, captions=captions))
    words = (
        f"The first {DRAWN} episodes of each trained policy's evaluation (deterministic), a "
        "dot for each state, orange where the step there cost. J_R, J_C: return and cost of an "
        "episode, means of the whole evaluation."
    )
    return Figure(_file("trained", seen[0][0]), "png", content, "Trained policies", words)


def _words(run: Run) -> str:
    named = [(measure(name), run.measures[name]) for name in ("J_R", "J_C")]
    words = [f"{of.title} {value:.1f}" for of, value in named if value is not None]
    return f"seed {run.seed}: {', '.join(words)}"
