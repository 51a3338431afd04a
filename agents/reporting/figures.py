"""The figures of a report as SVG: training curves of a task, and figures over all tasks."""

from __future__ import annotations

import contextlib
import io
import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from textwrap import fill
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.algorithms import ALGORITHMS
from agents.results.groups import Group
from agents.results.measures import Measure, measures
from agents.results.names import by_task, in_order, publications
from agents.results.statistics import (
    INTERVALS,
    by_third,
    common_limit,
    group_mean,
    known,
    mean_of,
)
from agents.training.config import TrainConfig
from agents.training.derive import thousandths
from circle2d_mj.registration import CIRCLE2D
from emcc import EpisodeRecords, emcc, iqm, profile
from emcc.parts import ALPHA, PARTS
from emcc.statistics import COST, SHARE, UNBOUNDED, Bounds

# Okabe and Ito's palette: distinguishable with any colour vision.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#000000", "#56B4E9")
DASHES = ("-", (0, (5, 1.5)), (0, (1, 1)), (0, (6, 1.5, 1, 1.5)), (0, (3, 1, 1, 1, 1, 1)))
DASHES = (*DASHES, (0, (9, 2)), (0, (2, 2.5)), (0, (9, 1.5, 3, 1.5)))
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
"""One marker per dash, so that curves can be told apart without colour."""
CROWDED, PIXELS = 60, 120
"""Number of lines and areas above which a panel is rasterised, and pixels per inch. Otherwise the
page of very many runs would have many megabytes."""
DOT: dict[str, Any] = {"linestyle": "", "alpha": 0.55, "markeredgewidth": 0}
BELOW: dict[str, Any] = {"loc": "outside lower center", "frameon": False, "handlelength": 3}
"""Look of a legend below a figure."""
ASPECT = 0.78
"""Height of a panel of learning curves, as a share of its width."""
POINTS = 50
"""Number of points of a curve along training."""
WINDOW = 0.1
"""Width of the running EMCC's window, as a share of training."""
THRESHOLDS = np.linspace(0, 1, 51)
"""Thresholds of MCC at which profiles are drawn."""


class Figure(NamedTuple):
    """A picture with its title and caption."""

    content: bytes
    """SVG."""
    title: str
    caption: str


class Style(NamedTuple):
    """The look of a group's runs."""

    colour: str
    """The same for all groups of an algorithm."""
    dash: Any
    """Depends on the algorithm; further groups of the algorithm in a figure get other dashes."""
    marker: str
    """Chosen in the same way as the dash."""


def styles(configs: Sequence[TrainConfig]) -> list[Style]:
    """Return the styles of a figure's groups, from the index of their algorithm among all."""
    order = {name: index for index, name in enumerate(ALGORITHMS)}
    places = [order.get(config.algorithm, len(order)) for config in configs]
    taken, chosen = set(), []
    for k, place in enumerate(places):
        wanted = place % len(DASHES)
        if place in places[:k]:
            free = set(range(len(DASHES))) - taken - {p % len(DASHES) for p in places}
            wanted = min(free, default=wanted)
        taken.add(wanted)
        chosen.append(Style(COLOURS[place % len(COLOURS)], DASHES[wanted], MARKERS[wanted]))
    return chosen


@contextlib.contextmanager
def drawing(font_size: int = 10) -> Iterator[Any]:
    """Yield pyplot, set up without a display so that equal input gives equal files."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    with pyplot.rc_context({"svg.hashsalt": "circle2d", "font.size": font_size}):
        yield pyplot


def svg_of(figure: Any) -> bytes:
    """Return a matplotlib figure as SVG and close it; crowded panels are rasterised."""
    from matplotlib import pyplot

    for axis in figure.axes:
        if len(axis.lines) + len(axis.collections) > CROWDED:
            axis.set_rasterization_zorder(2.1)  # lines and areas, but not axes and text
    image = io.StringIO()
    figure.savefig(image, format="svg", dpi=PIXELS, metadata={"Date": None})
    pyplot.close(figure)
    figure.clear()  # otherwise a reference cycle keeps tens of megabytes

    # Coordinates to a fraction of a point: a third of the size, without a visible difference.
    def shorter(attribute: re.Match[str]) -> str:
        digits = 1 if attribute[1] == "d" else 2
        return re.sub(r"-?\d+\.\d{2,}", lambda x: f"{float(x[0]):.{digits}f}", attribute[0])

    return re.sub(r' (d|x|y)="[^"]*"', shorter, image.getvalue()).encode()


def legend(names: Collection[str]) -> tuple[int, float]:
    """Return the number of columns, at most six, of a legend below a figure nine inches wide, and
    the inches of extra height for the legend's further lines."""
    columns = min(max(1, 110 // (8 + max(map(len, names)))), 6)
    return columns, 0.2 * max(math.ceil(len(names) / columns) - 2, 0)


class Curve(NamedTuple):
    """Mean over runs at points of training, with its interval or range as in tables.

    NaN where a run has no value; low and high are NaN for a single run too."""

    mean: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]


def midpoints(total_steps: int) -> NDArray[np.float64]:
    """Return the environment steps of a curve's points, [POINTS]: midpoints of equal parts."""
    return (np.arange(POINTS) + 0.5) / POINTS * total_steps


def episode_means(group: Group, column: Literal["reward", "cost", "length"]) -> Curve:
    """Return the mean of a column over the episodes that start in each part; NaN if none does.

    column: "reward" (the return), "cost" or "length".
    """
    rows, total_steps = [], group.total_steps
    for records in (run.records for run in group.runs):
        part = np.minimum(records.start_step * POINTS // total_steps, POINTS - 1)
        values = getattr(records, column)
        if column == "reward":  # rounded as in archives: reports from both are equal in each byte
            whole, scale = thousandths(records.reward)
            values = whole / scale
        sums = np.bincount(part, values, minlength=POINTS)
        count = np.bincount(part, minlength=POINTS)
        rows.append(np.where(count > 0, sums / np.maximum(count, 1), np.nan))
    return _over_runs(rows, group.one_place, UNBOUNDED if column == "reward" else COST)


def emcc_along(records: EpisodeRecords, total_steps: int) -> list[float]:
    """Return EMCC of a run's rollouts that start within half a window of each midpoint; NaN if none
    does."""
    mcc, starts = records.mcc_per_rollout()
    near = (np.abs(starts - at) <= WINDOW / 2 * total_steps for at in midpoints(total_steps))
    return [emcc(mcc[chosen], ALPHA) if chosen.any() else np.nan for chosen in near]


def running_emcc(group: Group) -> Curve:
    """Return the curve of `emcc_along` over the runs of a group."""
    rows = [emcc_along(run.rollouts, group.total_steps) for run in group.runs]
    return _over_runs(rows, group.one_place, SHARE)


def _over_runs(rows: Sequence[Any], one_place: bool, bounds: Bounds) -> Curve:
    """Return the curve of the mean over runs; rows: each run's values, NaN or None if missing."""
    points = np.full((3, len(rows[0])), np.nan)
    for k, values in enumerate(np.array(rows, dtype=float).T):
        mean = mean_of(values.tolist(), one_place, bounds) if np.isfinite(values).all() else None
        if mean is not None:
            points[:, k] = [np.nan if v is None else v for v in (mean.value, mean.low, mean.high)]
    return Curve(*points)


def task_figures(groups: Sequence[Group]) -> list[Figure]:
    """Return the figures of one task; groups: its runs."""
    groups = [group for group in in_order(groups) if group.runs]
    return [curves([(group.name, group) for group in groups])] if groups else []


def curves(named: Sequence[tuple[str, Group]]) -> Figure:
    """Draw training curves of named groups on one task: return, cost return, running EMCC and,
    where it varies, the length of episodes. Equal input gives equal bytes."""
    groups = [group for _, group in named]
    limit, task = common_limit(groups), groups[0].task
    lengths = {n for group in groups for run in group.runs for n in np.unique(run.records.length)}
    measures = ["return", "cost", "emcc", *["length"] * (len(lengths) > 1)]
    with drawing(8) as pyplot:
        svg = svg_of(draw_along(pyplot, {task: named}, measures, width=9.0))
    words = (
        f"Training's episodes. Lines: mean over seeds; areas: {INTERVALS}. EMCC: α = {ALPHA:g}, in "
        "a window of a tenth of training."
    )
    if limit is not None:
        words += f" Dotted line: the cost limit, {limit:g}."
    return Figure(svg, "Training curves", words)


class Along(NamedTuple):
    """A measure along training, and the label of its column of panels."""

    label: str
    of: Callable[[Group], Curve]


ALONG = {
    "return": Along("return", lambda group: episode_means(group, "reward")),
    "cost": Along("cost", lambda group: episode_means(group, "cost")),
    "emcc": Along("EMCC", running_emcc),
    "length": Along("steps of an episode", lambda group: episode_means(group, "length")),
}
"""Measures that can be drawn along training."""


def draw_along(
    pyplot: Any,
    tasks: Mapping[str, Sequence[tuple[str, Group]]],
    measures: Sequence[str],
    width: float,
    colours: Mapping[str, str] | None = None,
) -> Any:
    """Return a matplotlib figure with a row of panels for each task and a column for each measure.

    tasks: groups with their names in the legend. measures: of `ALONG`. width: inches, for text 8
    points high. colours: for groups that get another one than their algorithm's, by `Group.name`.
    """
    from matplotlib.ticker import EngFormatter

    columns = [ALONG[name] for name in measures]
    shown = {*(name for named in tasks.values() for name, _ in named), "cost limit"}
    fitting = max(1, min(len(shown), int(14 * width) // (max(map(len, shown)) + 7)))
    below = 0.16 * math.ceil(len(shown) / fitting)
    height = len(tasks) * ASPECT * width / len(columns) + below + 0.4
    figure, axes = pyplot.subplots(
        len(tasks),
        len(columns),
        figsize=(width, height),
        layout="constrained",
        squeeze=False,
        sharex="row",
    )
    handles: dict[str, Any] = {}
    for row, (task, named) in zip(axes, tasks.items(), strict=True):
        groups = [group for _, group in named]
        looks = styles([group.config for group in groups])
        limit = common_limit(groups)
        for axis, column in zip(row, columns, strict=True):
            for (name, group), look in zip(named, looks, strict=True):
                own = look._replace(colour=(colours or {}).get(group.name, look.colour))
                draw_curve(axis, name, own, midpoints(group.total_steps), column.of(group))
                handles.setdefault(name, axis.lines[-1])
            if column.label == "cost" and limit is not None:
                line = axis.axhline(limit, color="#666666", linewidth=0.8, linestyle=":")
                handles["cost limit"] = line
            if column.label == "EMCC":
                axis.set_ylim(0, 1)
            axis.set_xlim(0, max(group.total_steps for group in groups))
            axis.xaxis.set_major_formatter(EngFormatter(sep=""))
            axis.spines[["top", "right"]].set_visible(False)
        row[0].set_ylabel(task.removeprefix("circle2d_mj/"))
    for axis, column in zip(axes[0], columns, strict=True):
        axis.set_title(column.label, fontsize=8)
    for axis in axes[-1]:
        axis.set_xlabel("environment steps")
    figure.legend(handles.values(), handles, ncols=fitting, **BELOW)
    return figure


def draw_curve(axis: Any, name: str, style: Style, at: NDArray, curve: Curve) -> None:
    """Draw a line where the curve is known, and an area between its low and high ends."""
    there = np.isfinite(curve.mean)  # with few episodes, none starts in some parts
    at, (mean, low, high) = at[there], (ends[there] for ends in curve)
    look = {"color": style.colour, "linestyle": style.dash}
    axis.plot(at, mean, linewidth=1.5, label=name, **look)
    axis.fill_between(at, low, high, color=style.colour, alpha=0.15, linewidth=0)


def intervals_figure(groups: Sequence[Group]) -> Figure:
    """Draw every measure of every run, with each algorithm's mean and interval.

    A row of panels for each task, a column for each measure.
    """
    tasks, columns = by_task(groups), measures()
    named = {task: [_wrapped(g.name, 34) for g in own] for task, own in tasks.items()}
    # A row has room for two lines of a name; the task's name is beside the rows.
    lines = {task: max(name.count("\n") + 1 for name in names) for task, names in named.items()}
    heights = [max(len(own) * max(lines[task] / 2, 1), 5) for task, own in tasks.items()]
    one_scale = all(task.rpartition(":")[2] in CIRCLE2D for task in tasks)
    with drawing(8) as pyplot:
        figure, axes = pyplot.subplots(
            len(tasks),
            len(columns),
            figsize=(1.2 * len(columns) + 1.2, 0.22 * sum(heights) + 0.45 * len(tasks) + 0.7),
            layout="constrained",
            squeeze=False,
            height_ratios=heights,
            sharex="col" if one_scale else False,
        )
        for row, (task, own) in zip(axes, tasks.items(), strict=True):
            drawn = list(zip(own, styles([group.config for group in own]), strict=True))
            for axis, m in zip(row, columns, strict=True):
                _draw_runs(axis, drawn, m)
                _frame(axis, len(own), m)
            row[0].set_yticks(range(len(own)), named[task])
            row[0].set_ylabel(task.removeprefix("circle2d_mj/"), fontweight="bold")
        for axis, m in zip(axes[0], columns, strict=True):
            axis.set_title(_wrapped(m.head, 18), fontsize=9)
        content = svg_of(figure)
    words = (
        "A dot for each run. Black bar: mean over seeds, its line the 95 % t interval of five "
        "seeds or more that end in one place; grey bar: interquartile mean"
    )
    crosses = publications(group for own in tasks.values() for group in own)
    words += f"; cross: {crosses}." if crosses else "."
    return Figure(content, "Every run", words)


def _wrapped(name: str, width: int) -> str:
    """Return a name in lines of at most `width`; text in brackets starts on a new line."""
    return "\n".join(fill(line, width) for line in name.replace(" (", "\n(").splitlines())


def _draw_runs(axis: Any, drawn: Sequence[tuple[Group, Style]], m: Measure) -> None:
    """Draw a row for each group. For speed, one artist holds the bars or crosses of all rows."""
    means, middles, crosses = [], [], []
    for place, (group, style) in enumerate(drawn):
        values, mean = known(group.values(m.name)), group_mean(group, m.name)
        if values is not None and mean is not None:
            at = place + 0.3 * np.linspace(-1, 1, len(values)) * (len(values) > 1)
            axis.plot(values, at, marker="o", markersize=3.5, color=style.colour, **DOT)
            if mean.kind == "t":
                axis.plot([mean.low, mean.high], [place, place], color=style.colour, linewidth=1.6)
            means.append((mean.value, place))
            middles.append((iqm(values), place))
        if m.name in group.printed:
            crosses.append((group.printed[m.name], place))
    looks = ("|", 11, "#999999"), ("|", 11, "black"), ("x", 5, "black")
    for points, (marker, size, colour) in zip((middles, means, crosses), looks, strict=True):
        if points:
            look = {"marker": marker, "markersize": size, "color": colour, "linestyle": ""}
            axis.plot(*np.array(points).T, **look)


def _frame(axis: Any, rows: int, m: Measure) -> None:
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
    if m.stem == "EMCC":
        axis.set_xlim(-0.03, 1.03)


def rates_figure(groups: Sequence[Group]) -> Figure:
    """Draw cost rate against EMCC, a dot per run: a row for each task, a column for each third."""

    def draw(axis: Any, group: Group, part: float, style: Style) -> None:
        points = [by_third(group, stem)[part] for stem in ("rate", "EMCC")]
        look = {"marker": style.marker, "color": style.colour, "markersize": 5}
        axis.plot(*points, label=group.name, **look, **DOT)

    labels = ("cost rate of the third", f"EMCC (α = {ALPHA:g})")
    words = (
        "A marker for each run in a third of its training. Runs above each other have equal cost "
        "rates and different EMCC. Each task has a scale of its own."
    )
    content = _facets(groups, labels, draw, scale="row")
    return Figure(content, "Cost rate against EMCC", words)


def profiles_figure(groups: Sequence[Group]) -> Figure:
    """Draw the share of rollouts whose MCC is above each threshold, by task and third."""

    def draw(axis: Any, group: Group, part: float, style: Style) -> None:
        thirds = [run.rollouts.by_part(run.total_steps)[part] for run in group.runs]
        shares = np.array([profile(of.mcc_per_rollout()[0], THRESHOLDS) for of in thirds])
        means = [mean_of(values.tolist(), group.one_place, SHARE) for values in shares.T]
        look = {"color": style.colour, "linestyle": style.dash, "linewidth": 1.4}
        axis.plot(THRESHOLDS, [mean.value for mean in means if mean], label=group.name, **look)
        ends = [(mean.low, mean.high) for mean in means if mean and mean.low is not None]
        if ends:
            band = np.array(ends, dtype=float).T
            axis.fill_between(THRESHOLDS, *band, color=style.colour, alpha=0.13, linewidth=0)

    words = (
        "Share of a third's rollouts whose MCC, the longest streak of cost steps over the "
        f"episode's length, is above τ. Lines: mean over seeds; areas: {INTERVALS}. EMCC is the "
        f"mean of the MCC right of where a run's line crosses {ALPHA:g} (dotted)."
    )
    content = _facets(groups, ("τ", "P(MCC > τ)"), draw, level=ALPHA)
    return Figure(content, "Profiles of MCC", words)


def _facets(
    groups: Sequence[Group],
    labels: tuple[str, str],
    draw: Callable[[Any, Group, float, Style], None],
    level: float | None = None,
    scale: Literal["all", "row"] = "all",
) -> bytes:
    """Draw panels by task (rows) and third (columns), with one legend. level: height of a dotted
    line. scale: whether "all" panels share a scale, or each "row", that is each task, has one."""
    tasks = by_task(groups)
    legend_columns, height = legend({group.name for group in groups})
    with drawing(9) as pyplot:
        figure, axes = pyplot.subplots(
            len(tasks),
            len(PARTS),
            figsize=(9.5, 2.1 * len(tasks) + 1.0 + height),
            layout="constrained",
            squeeze=False,
            sharex=scale,
            sharey=scale,
        )
        handles: dict[str, Any] = {}
        for row, (task, own) in zip(axes, tasks.items(), strict=True):
            for group, style in zip(own, styles([group.config for group in own]), strict=True):
                there = by_third(group, "rate")
                for axis, part in zip(row, PARTS, strict=True):
                    if part in there:
                        draw(axis, group, part, style)
                        handles.setdefault(group.name, axis.lines[-1])
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
        if scale == "all":
            axes[0][0].set_ylim(-0.03, 1.03)
        figure.legend(handles.values(), handles, ncols=legend_columns, **BELOW)
        return svg_of(figure)
