"""Return, cost return and EMCC over training: numbers, and the figure."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.results.precision import five_digits
from emcc import EpisodeRecords, emcc, emcc_by_part
from emcc.parts import PARTS

POINTS = 50
"""Along the training."""
WINDOW = 0.1
"""Of the running EMCC, as a share of the training."""
# Okabe and Ito's palette, which people with any colour vision can tell apart.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
DASHES = ("-", "--", ":", "-.")


class Curve(NamedTuple):
    """Of some runs: mean and standard deviation over them, at some points of training."""

    mean: NDArray[np.float64]
    spread: NDArray[np.float64]


def midpoints(total_steps: int) -> NDArray[np.float64]:
    """The environment steps that the points stand for: [POINTS], the middles of equal parts."""
    return (np.arange(POINTS) + 0.5) / POINTS * total_steps


def episode_means(
    records: Sequence[EpisodeRecords], column: Literal["reward", "cost"], total_steps: int
) -> Curve:
    """The mean of a column of the episodes that start in each part; NaN where none does.

    column: "reward" (the return) or "cost". Spread is over runs, as in the paper's training curves.
    """
    rows = []
    for of_run in records:
        part = np.minimum(of_run.start_step * POINTS // total_steps, POINTS - 1)
        values = of_run.cost
        if column == "reward":  # as archives keep it, so that a report from one has the same bytes
            values = five_digits(of_run.reward)
        sums = np.bincount(part, values, minlength=POINTS)
        count = np.bincount(part, minlength=POINTS)
        rows.append(np.where(count > 0, sums / np.maximum(count, 1), np.nan))
    return _over_runs(rows)


def running_emcc(records: Sequence[EpisodeRecords], total_steps: int, alpha: float) -> Curve:
    """EMCC of the rollouts that start within half a window of each point; NaN where none does."""
    rows = []
    for of_run in records:
        mcc, starts = of_run.mcc_per_rollout()
        near = [np.abs(starts - s) <= WINDOW / 2 * total_steps for s in midpoints(total_steps)]
        rows.append([emcc(mcc[chosen], alpha) if chosen.any() else np.nan for chosen in near])
    return _over_runs(rows)


def thirds_emcc(records: Sequence[EpisodeRecords], total_steps: int, alpha: float) -> Curve:
    """EMCC of the thirds of training: mean and spread [3]."""
    return _over_runs(
        [
            list(emcc_by_part(*of_run.mcc_per_rollout(), total_steps, alpha).values())
            for of_run in records
        ]
    )


def _over_runs(rows: Sequence[Sequence[float] | NDArray]) -> Curve:
    values = np.array(rows)
    known = ~np.isnan(values).any(axis=0)
    mean, spread = np.full((2, values.shape[1]), np.nan)
    mean[known], spread[known] = values[:, known].mean(axis=0), values[:, known].std(axis=0)
    return Curve(mean, spread)


class Line(NamedTuple):
    """Runs that the figure draws as one line."""

    name: str
    colour: int
    """Place in `COLOURS`; lines of one colour differ in their dashes"""
    records: Sequence[EpisodeRecords]
    """Of each run"""
    total_steps: int


def curves_svg(title: str, lines: Sequence[Line], cost_limit: float | None, alpha: float) -> str:
    """The figure of a task as SVG: return, cost return, running EMCC, and EMCC of the thirds.

    cost_limit: a dashed line, if the runs share one. Equal input gives equal bytes.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    with pyplot.rc_context({"svg.hashsalt": "circle2d", "font.size": 10}):
        figure, ((returns, costs), (running, thirds)) = pyplot.subplots(
            2, 2, figsize=(9, 6), layout="constrained"
        )
        figure.suptitle(title)
        for k, line in enumerate(lines):
            records, steps = line.records, line.total_steps
            before = sum(other.colour == line.colour for other in lines[:k])
            style = {
                "color": COLOURS[line.colour % len(COLOURS)],
                "linestyle": DASHES[before % len(DASHES)],
                "label": line.name,
            }
            _draw(returns, steps, episode_means(records, "reward", steps), style)
            _draw(costs, steps, episode_means(records, "cost", steps), style)
            _draw(running, steps, running_emcc(records, steps, alpha), style)
            _draw_thirds(thirds, thirds_emcc(records, steps, alpha), k, len(lines), style)
        if cost_limit is not None:
            dashes = {"color": "black", "linestyle": "--", "linewidth": 0.9}
            costs.axhline(cost_limit, label="cost limit", **dashes)
        _label(((returns, costs), (running, thirds)), max(line.total_steps for line in lines))
        columns = max(1, 100 // (8 + max(len(line.name) for line in lines)))
        handles = costs.get_legend_handles_labels()
        figure.legend(*handles, loc="outside lower center", ncols=min(columns, 6), frameon=False)
        image = io.StringIO()
        figure.savefig(image, format="svg", metadata={"Date": None})
        pyplot.close(figure)
    return image.getvalue()


def _draw(axis: Any, total_steps: int, curve: Curve, style: dict[str, Any]) -> None:
    at, low, high = midpoints(total_steps), curve.mean - curve.spread, curve.mean + curve.spread
    axis.plot(at, curve.mean, linewidth=1.5, **style)
    axis.fill_between(at, low, high, color=style["color"], alpha=0.15, linewidth=0)


def _draw_thirds(axis: Any, curve: Curve, k: int, count: int, style: dict[str, Any]) -> None:
    """The k-th of `count` lines, beside the others of each third."""
    at = np.arange(len(curve.mean)) + (k - (count - 1) / 2) * 0.6 / count
    bars = axis.errorbar(at, curve.mean, curve.spread, fmt="o", markersize=5, color=style["color"])
    for bar in bars[2]:
        bar.set_linestyle(style["linestyle"])


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
