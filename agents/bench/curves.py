"""How return, cost return and EMCC went over training: numbers, and the figure."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from emcc import EpisodeRecords, emcc

POINTS = 50
"""Along the training."""
WINDOW = 0.1
"""Of the running EMCC, as a share of the training."""
# Okabe and Ito's palette, which people with any colour vision can tell apart.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")


class Curve(NamedTuple):
    """Of some runs: mean and standard deviation over them, at `POINTS` points of training."""

    mean: NDArray[np.float64]
    spread: NDArray[np.float64]


def midpoints(total_steps: int) -> NDArray[np.float64]:
    """The environment steps that the points stand for: [POINTS], the middles of equal parts."""
    return (np.arange(POINTS) + 0.5) / POINTS * total_steps


def episode_means(records: Sequence[EpisodeRecords], column: str, total_steps: int) -> Curve:
    """The mean of a column of the episodes that start in each part; NaN where none does.

    column: "reward" (the return) or "cost". Spread is over runs, as in the paper's training curves.
    """
    rows = []
    for of_run in records:
        part = np.minimum(of_run.start_step * POINTS // total_steps, POINTS - 1)
        sums = np.bincount(part, getattr(of_run, column), minlength=POINTS)
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


def _over_runs(rows: Sequence[Sequence[float] | NDArray]) -> Curve:
    values = np.array(rows)
    known = ~np.isnan(values).any(axis=0)
    mean, spread = np.full(POINTS, np.nan), np.full(POINTS, np.nan)
    mean[known], spread[known] = values[:, known].mean(axis=0), values[:, known].std(axis=0)
    return Curve(mean, spread)


def curves_svg(
    title: str,
    groups: Mapping[str, Sequence[EpisodeRecords]],
    total_steps: Mapping[str, int],
    cost_limit: float | None,
    alpha: float,
) -> str:
    """The figure of a task as SVG: return, cost return and running EMCC; lines by group.

    groups: the records of the runs of each; cost_limit: a dashed line, if they share one. Equal
    input gives equal bytes.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    with pyplot.rc_context({"svg.hashsalt": "circle2d", "font.size": 9}):
        figure, axes = pyplot.subplots(1, 3, figsize=(11, 3.2), layout="constrained")
        figure.suptitle(title)
        for colour, (name, records) in zip(_cycle(len(groups)), groups.items(), strict=True):
            steps = total_steps[name]
            for axis, curve in zip(
                axes,
                (
                    episode_means(records, "reward", steps),
                    episode_means(records, "cost", steps),
                    running_emcc(records, steps, alpha),
                ),
                strict=True,
            ):
                low, high = curve.mean - curve.spread, curve.mean + curve.spread
                axis.plot(midpoints(steps), curve.mean, color=colour, label=name, linewidth=1.4)
                axis.fill_between(
                    midpoints(steps), low, high, color=colour, alpha=0.15, linewidth=0
                )
        for axis, words in zip(
            axes, ("return", "cost return", f"EMCC, α = {alpha:g}, window of a tenth"), strict=True
        ):
            axis.set(xlabel="environment steps", title=words)
            axis.spines[["top", "right"]].set_visible(False)
        if cost_limit is not None:
            axes[1].axhline(cost_limit, color="black", linestyle="--", linewidth=0.8)
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=7)
        image = io.StringIO()
        figure.savefig(image, format="svg", metadata={"Date": None})
        pyplot.close(figure)
    return image.getvalue()


def _cycle(count: int) -> list[str]:
    return [COLOURS[k % len(COLOURS)] for k in range(count)]
