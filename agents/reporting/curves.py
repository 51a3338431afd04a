"""Return, cost return and EMCC over training: numbers, and the figure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.reporting.style import Style, drawing, legend, svg_of
from agents.results.precision import five_digits
from agents.results.statistics import mean_of
from emcc import EpisodeRecords, emcc, emcc_by_part
from emcc.parts import PARTS
from emcc.statistics import COST, SHARE, UNBOUNDED, Bounds

POINTS = 50
"""Along the training."""
WINDOW = 0.1
"""Of the running EMCC, as a share of the training."""


class Curve(NamedTuple):
    """Of some runs at some points of training: the mean over them with its interval or range, as in
    tables. NaN where a run has nothing, low and high also of a single run."""

    mean: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]


class Line(NamedTuple):
    """Runs that the figure draws as one line."""

    name: str
    style: Style
    records: Sequence[EpisodeRecords]
    """Of each run"""
    total_steps: int
    one_place: bool = True
    """Whether all runs end in the same place: of others there is no interval, but a range."""


def midpoints(total_steps: int) -> NDArray[np.float64]:
    """The environment steps that the points stand for: [POINTS], the middles of equal parts."""
    return (np.arange(POINTS) + 0.5) / POINTS * total_steps


def episode_means(line: Line, column: Literal["reward", "cost"]) -> Curve:
    """The mean of a column of the episodes that start in each part; NaN where none does.

    column: "reward" (the return) or "cost".
    """
    rows, total_steps = [], line.total_steps
    for of_run in line.records:
        part = np.minimum(of_run.start_step * POINTS // total_steps, POINTS - 1)
        values = of_run.cost
        if column == "reward":  # as archives keep it, so that a report from one has the same bytes
            values = five_digits(of_run.reward)
        sums = np.bincount(part, values, minlength=POINTS)
        count = np.bincount(part, minlength=POINTS)
        rows.append(np.where(count > 0, sums / np.maximum(count, 1), np.nan))
    return _over_runs(rows, line.one_place, COST if column == "cost" else UNBOUNDED)


def running_emcc(line: Line, alpha: float) -> Curve:
    """`emcc_along` of each run."""
    rows = [emcc_along(of_run, line.total_steps, alpha) for of_run in line.records]
    return _over_runs(rows, line.one_place, SHARE)


def emcc_along(records: EpisodeRecords, total_steps: int, alpha: float) -> list[float]:
    """EMCC of the rollouts of a run that start within half a window of each of `midpoints`; NaN
    where none does."""
    mcc, starts = records.mcc_per_rollout()
    near = (np.abs(starts - at) <= WINDOW / 2 * total_steps for at in midpoints(total_steps))
    return [emcc(mcc[chosen], alpha) if chosen.any() else np.nan for chosen in near]


def thirds_emcc(line: Line, alpha: float) -> Curve:
    """EMCC of the thirds of training: [3]."""
    rows = [
        list(emcc_by_part(*of_run.mcc_per_rollout(), line.total_steps, alpha).values())
        for of_run in line.records
    ]
    return _over_runs(rows, line.one_place, SHARE)


def _over_runs(rows: Sequence[Sequence[float] | NDArray], one_place: bool, bounds: Bounds) -> Curve:
    found = np.full((3, len(rows[0])), np.nan)
    for k, values in enumerate(np.array(rows).T):
        mean = mean_of(values.tolist(), one_place, bounds) if np.isfinite(values).all() else None
        if mean is not None:
            found[:, k] = [np.nan if v is None else v for v in (mean.value, mean.low, mean.high)]
    return Curve(*found)


def curves_svg(title: str, lines: Sequence[Line], cost_limit: float | None, alpha: float) -> bytes:
    """The figure of a task as SVG: return, cost return, running EMCC, and EMCC of the thirds.

    cost_limit: a thin line, if the runs share one. Equal input gives equal bytes.
    """
    shape = legend([line.name for line in lines])
    with drawing() as pyplot:
        size = (9, 6 + shape.height)
        figure, axes = pyplot.subplots(2, 2, figsize=size, layout="constrained")
        (returns, costs), (running, thirds) = axes
        figure.suptitle(title)
        for k, line in enumerate(lines):
            _draw(returns, line, episode_means(line, "reward"))
            _draw(costs, line, episode_means(line, "cost"))
            _draw(running, line, running_emcc(line, alpha))
            _draw_thirds(thirds, line, thirds_emcc(line, alpha), (k, len(lines)))
        if cost_limit is not None:
            costs.axhline(cost_limit, label="cost limit", color="#888888", linewidth=0.9)
        _label(axes, max(line.total_steps for line in lines))
        handles, labels = costs.get_legend_handles_labels()
        below = {"loc": "outside lower center", "frameon": False, "handlelength": 3.2}
        figure.legend(handles, labels, ncols=shape.columns, **below)
        return svg_of(figure)


def _draw(axis: Any, line: Line, curve: Curve) -> None:
    at, (colour, dash, _) = midpoints(line.total_steps), line.style
    axis.plot(at, curve.mean, linewidth=1.5, color=colour, linestyle=dash, label=line.name)
    axis.fill_between(at, curve.low, curve.high, color=colour, alpha=0.15, linewidth=0)


def _draw_thirds(axis: Any, line: Line, curve: Curve, place: tuple[int, int]) -> None:
    """place: of the line, and the number of all lines, which stand beside each other."""
    (k, count), (colour, _, marker) = place, line.style
    at = np.arange(len(curve.mean)) + (k - (count - 1) / 2) * 0.6 / count
    axis.vlines(at, curve.low, curve.high, color=colour, linewidth=1.5)
    axis.plot(at, curve.mean, linestyle="", marker=marker, markersize=5, color=colour)


def _label(axes: Any, total_steps: int) -> None:
    from matplotlib.ticker import EngFormatter

    (returns, costs), (running, thirds) = axes
    names = ("return of an episode", "cost of an episode", "EMCC, running", "EMCC of the thirds")
    for axis, name in zip((returns, costs, running, thirds), names, strict=True):
        axis.set_ylabel(name)
        axis.spines[["top", "right"]].set_visible(False)
        if axis is not thirds:
            axis.set_xlabel("environment steps")
            axis.set_xlim(0, total_steps)
            axis.xaxis.set_major_formatter(EngFormatter(sep=""))
    for part in PARTS:
        running.axvline(part * total_steps, color="grey", linestyle=":", linewidth=0.9)
    for axis in (running, thirds):
        axis.set_ylim(0, 1.02)
    thirds.set_xticks(range(len(PARTS)), list(PARTS.values()))
    thirds.set_xlabel("part of training")
    thirds.set_xlim(-0.5, 2.5)
