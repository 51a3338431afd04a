"""The figures of a report: picture files, with the words below them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple

from agents.paper import introduction as example
from agents.paper.settings import cost_limit, in_order, name_of
from agents.reporting.curves import Line, curves_svg
from agents.reporting.image_files import png
from agents.reporting.style import styles
from agents.results.reading import Group
from agents.results.statistics import INTERVALS
from agents.results.steps import Episode, Visits
from circle2d_mj.core.view import Picture, View
from circle2d_mj.render import canvas
from emcc.parts import ALPHA

SIZE = 320
"""Pixels along the side of a picture in a figure."""


class Figure(NamedTuple):
    """A picture file and its words."""

    name: str
    """Of the file, without its suffix."""
    kind: Literal["png", "svg"]
    content: bytes
    title: str
    caption: str


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


def figures(groups: Sequence[Group]) -> list[Figure]:
    """The figures of one task, by its runs."""
    groups = [group for group in in_order(groups) if group.runs]
    return [curves([(name_of(group), group) for group in groups])] if groups else []


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


def visits_words(visits: Visits) -> str:
    """The line below a heat map."""
    return f"EMCC {visits.emcc:.2f} ({visits.rollouts:,} of {visits.of:,} rollouts)"
