"""Figures over all tasks of a report: every run beside its mean, and cost rate against EMCC."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from agents.algorithms import title
from agents.paper.presets import is_circle2d
from agents.paper.printed import paper_results
from agents.paper.settings import by_task, name_of
from agents.reporting.figures import Figure
from agents.reporting.style import Style, drawing, legend, styles, svg_of
from agents.results import thirds
from agents.results.measures import Measure, measures
from agents.results.reading import Group
from agents.results.statistics import group_mean, iqm_of, known, mean_of
from emcc import profile
from emcc.parts import ALPHA, PARTS
from emcc.statistics import SHARE

THRESHOLDS = np.linspace(0, 1, 51)
"""Thresholds of MCC, of the profiles."""
DOT: dict[str, Any] = {"linestyle": "", "alpha": 0.55, "markeredgewidth": 0}


def intervals_figure(groups: Sequence[Group]) -> Figure:
    """Every measure of every run, with the mean and the interval of each algorithm.

    A row of panels for each task, a column for each measure.
    """
    tasks, columns = by_task(groups), measures()
    heights = [max(len(of_task), 5) for of_task in tasks.values()]  # the task's name stands beside
    with drawing(8) as pyplot:
        size = (1.2 * len(columns) + 1.2, 0.22 * sum(heights) + 0.45 * len(tasks) + 0.7)
        figure, axes = pyplot.subplots(
            len(tasks),
            len(columns),
            figsize=size,
            layout="constrained",
            squeeze=False,
            height_ratios=heights,
            sharex="col" if all(map(is_circle2d, tasks)) else False,
        )
        for row, (task, of_task) in zip(axes, tasks.items(), strict=True):
            drawn = list(zip(of_task, styles([g.config for g in of_task]), strict=True))
            for axis, measure in zip(row, columns, strict=True):
                _draw_runs(axis, drawn, measure)
                _frame(axis, len(of_task), measure)
            names = [name_of(group).replace(" (", "\n(") for group in of_task]
            row[0].set_yticks(range(len(of_task)), names)
            row[0].set_ylabel(task.removeprefix("circle2d_mj/"), fontweight="bold")
        for axis, measure in zip(axes[0], columns, strict=True):
            axis.set_title(measure.head.replace(" (", "\n("), fontsize=9)
        content = svg_of(figure)
    words = (
        "A dot for each run. Black bar: the mean over seeds; grey bar: the interquartile mean; "
        "line: the 95 % t interval of the mean, drawn where there are five seeds or more that "
        "end in one place. Cross: the paper's printed value."
    )
    return Figure("intervals", "svg", content, "Every run", words)


def _draw_runs(axis: Any, drawn: Sequence[tuple[Group, Style]], measure: Measure) -> None:
    """A row for each group. The bars and crosses of all rows are one artist each, for speed."""
    means, middles, printed = [], [], []
    for place, (group, style) in enumerate(drawn):
        values = known(group.values(measure.name))
        mean = group_mean(group, measure.name)
        if values is not None and mean is not None:
            at = place + 0.3 * np.linspace(-1, 1, len(values)) * (len(values) > 1)
            axis.plot(values, at, marker="o", markersize=3.5, color=style.colour, **DOT)
            if mean.kind == "t":
                axis.plot([mean.low, mean.high], [place, place], color=style.colour, linewidth=1.6)
            means.append((mean.value, place))
            middles.append((iqm_of(values), place))
        of_paper = paper_results(group.config.task, title(group.config.algorithm))
        if measure.name in of_paper:
            printed.append((of_paper[measure.name], place))
    looks = ("|", 11, "#999999"), ("|", 11, "black"), ("x", 5, "black")
    for points, (marker, size, colour) in zip((middles, means, printed), looks, strict=True):
        if points:
            look = {"marker": marker, "markersize": size, "color": colour, "linestyle": ""}
            axis.plot(*np.array(points).T, **look)


def _frame(axis: Any, rows: int, measure: Measure) -> None:
    from matplotlib.ticker import MaxNLocator

    axis.set_ylim(rows - 0.5, -0.5)
    axis.set_yticks([])
    axis.grid(axis="x", color="#dddddd", linewidth=0.6)
    axis.set_axisbelow(True)
    axis.spines[["top", "right", "left"]].set_visible(False)
    axis.tick_params(labelsize=7, length=2)
    axis.xaxis.set_major_locator(MaxNLocator(2))
    across = {"transform": axis.get_yaxis_transform(), "color": "#eeeeee", "linewidth": 0.6}
    axis.hlines(np.arange(1, rows) - 0.5, 0, 1, **across)
    if measure.word == "EMCC":
        axis.set_xlim(-0.03, 1.03)


def rates_figure(groups: Sequence[Group]) -> Figure:
    """Cost rate against EMCC, a dot for each run: a row for each task, a column for each third."""

    def draw(axis: Any, of_third: Sequence[thirds.Third], style: Style, group: Group) -> None:
        points = np.array([(third.cost_rate, third.emcc) for third in of_third])
        look = {"marker": style.marker, "color": style.colour, "markersize": 5}
        axis.plot(*points.T, label=name_of(group), **look, **DOT)

    labels = ("cost rate of the third", f"EMCC (α = {ALPHA:g})")
    content = _facets(groups, labels, draw)
    words = (
        "A marker for each run in a third of its training: cost per step, and EMCC, both of the "
        "rollouts that start in the third. Runs above each other have equal cost rates and "
        "different EMCC."
    )
    return Figure("cost-rate-against-emcc", "svg", content, "Cost rate against EMCC", words)


def profiles_figure(groups: Sequence[Group]) -> Figure:
    """Share of rollouts whose MCC is above each threshold, by task and third."""

    def draw(axis: Any, of_third: Sequence[thirds.Third], style: Style, group: Group) -> None:
        shares = np.array([profile(third.mcc, THRESHOLDS) for third in of_third])
        found = [mean_of(values.tolist(), group.one_place, SHARE) for values in shares.T]
        look = {"color": style.colour, "linestyle": style.dash, "linewidth": 1.4}
        axis.plot(THRESHOLDS, [of.value for of in found if of], label=name_of(group), **look)
        ends = [(of.low, of.high) for of in found if of and of.low is not None]
        if ends:
            band = np.array(ends, dtype=float).T
            axis.fill_between(THRESHOLDS, *band, color=style.colour, alpha=0.13, linewidth=0)

    content = _facets(groups, ("τ", "P(MCC > τ)"), draw, level=ALPHA)
    words = (
        "Performance profiles: the share of a third's rollouts whose MCC, the longest chain of "
        "cost steps over the episode's length, is above τ. Lines: the mean over seeds; areas: the "
        "95 % t interval, or the range of seeds that are fewer than five or end in different "
        "places. EMCC is the "
        f"mean of the MCC right of where a run's line crosses {ALPHA:g} (dotted)."
    )
    return Figure("profiles", "svg", content, "Profiles of MCC", words)


def _facets(
    groups: Sequence[Group], labels: tuple[str, str], draw: Any, level: float | None = None
) -> bytes:
    """Panels by task (rows) and third (columns), with one legend. level: of a dotted line."""
    tasks = by_task(groups)
    shape = legend({name_of(group) for group in groups})
    with drawing(9) as pyplot:
        figure, axes = pyplot.subplots(
            len(tasks),
            len(PARTS),
            figsize=(9.5, 2.1 * len(tasks) + 1.0 + shape.height),
            layout="constrained",
            squeeze=False,
            sharex=True,
            sharey=True,
        )
        handles: dict[str, Any] = {}
        for row, (task, of_task) in zip(axes, tasks.items(), strict=True):
            for group, style in zip(of_task, styles([g.config for g in of_task]), strict=True):
                for axis, of_third in zip(row, thirds.of_group(group).values(), strict=True):
                    draw(axis, of_third, style, group)
                    handles.setdefault(name_of(group), axis.lines[-1])
            row[0].set_ylabel(f"{task.removeprefix('circle2d_mj/')}\n{labels[1]}")
            for axis in row:
                axis.spines[["top", "right"]].set_visible(False)
                axis.grid(color="#e5e5e5", linewidth=0.6)
                if level is not None:
                    axis.axhline(level, color="#666666", linestyle=":", linewidth=1)
        for axis, words in zip(axes[0], PARTS.values(), strict=True):
            axis.set_title(f"{words} of training", fontsize=9)
        for axis in axes[-1]:
            axis.set_xlabel(labels[0])
        axes[0][0].set_ylim(-0.03, 1.03)
        below = {"loc": "outside lower center", "frameon": False, "handlelength": 3}
        figure.legend(handles.values(), handles, ncols=shape.columns, **below)
        return svg_of(figure)
