"""Draw figures from reports' numbers: cost rate against EMCC, a dot for each run, and the
benchmark's ranks by each of the two.

python docs/_ext/readme_figure.py
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from results_table import (
    RESULTS,
    SAFETY_TASKS,
    baseline_ranks,
    mean_rank,
    on_safety_task,
    report,
)

from agents.algorithms import ALGORITHMS
from agents.reporting.figures import COLOURS, MARKERS

PICTURE = RESULTS / "pictures" / "cost-rate-emcc.png"
SAFETY = RESULTS / "pictures" / "safety-tasks.png"
RANKS = RESULTS / "pictures" / "ranks.png"
APART = 0.55
"""Least distance between two names, in ranks, so that they can be read."""

ORDER = [algorithm.title for algorithm in ALGORITHMS.values()]


def look(name: str) -> dict[str, str]:
    """Return colour and marker of an algorithm, as in reports."""
    place = ORDER.index(name)
    return {"color": COLOURS[place % len(COLOURS)], "marker": MARKERS[place % len(MARKERS)]}


def draw(lines: Mapping[str, pd.DataFrame], picture: Path) -> None:
    """Draw a panel for each title, two per row, with a dot for each run with preset settings."""
    rows, columns = -(-len(lines) // 2), min(2, len(lines))
    figure = plt.figure(figsize=(2 + 4.2 * columns, 3.6 * rows), layout="constrained")
    drawn = {}
    for place, (title, own) in enumerate(lines.items(), start=1):
        axes = figure.add_subplot(rows, columns, place)
        presets = own[(own.kind == "run") & ~own.algorithm.str.contains("(", regex=False)]
        by_name = dict(list(presets.groupby("algorithm")))
        for name in sorted(by_name, key=ORDER.index):
            (drawn[name],) = axes.plot(
                by_name[name].cost_rate,
                by_name[name]["EMCC_0.99"],
                linestyle="",
                **look(name),
                markersize=6,
                alpha=0.8,
                markeredgewidth=0,
                label=name,
            )
        axes.set_title(title, fontsize=10)
        axes.set(xlabel="cost rate (cost a step, all of training)", ylabel="EMCC, last third")
        axes.set(xlim=(0, None), ylim=(0, None))
        axes.spines[["top", "right"]].set_visible(False)
    handles = [drawn[name] for name in sorted(drawn, key=ORDER.index)]
    figure.legend(handles=handles, frameon=False, loc="outside right upper")
    figure.savefig(picture, dpi=110)


def draw_ranks(picture: Path) -> None:
    """Draw a line for each algorithm, from its mean rank by the cost rate, left, to that by late
    EMCC, right."""
    ranks = {name: (mean_rank(b), mean_rank(a)) for name, (a, b) in baseline_ranks().items()}
    by_rate, by_emcc = (apart([both[side] for both in ranks.values()]) for side in (0, 1))
    figure, axes = plt.subplots(figsize=(7, 5.6))
    for (name, both), left, right in zip(ranks.items(), by_rate, by_emcc, strict=True):
        width = 1 + abs(both[1] - both[0]) / 2
        axes.plot((0, 1), both, markersize=6, linewidth=width, **look(name))
        axes.text(-0.04, left, f"{name}  {both[0]:.1f}", ha="right", va="center", fontsize=9)
        axes.text(1.04, right, f"{both[1]:.1f}  {name}", ha="left", va="center", fontsize=9)
    axes.invert_yaxis()
    axes.set(xlim=(-0.5, 1.5))
    axes.set_title(
        "mean rank by the cost rate and by EMCC in the last third, 1 the best", fontsize=10
    )
    axes.axis("off")
    figure.savefig(picture, dpi=110, bbox_inches="tight")


def apart(heights: Sequence[float]) -> list[float]:
    """Move heights down where they would be closer than `APART` to the one above."""
    moved, last = list(heights), -np.inf
    for k in np.argsort(heights, kind="stable"):
        moved[k] = last = max(heights[k], last + APART)
    return moved


if __name__ == "__main__":
    draw({"": pd.concat([report("circle2d"), report("solve")])}, PICTURE)
    draw({task.split("/")[1]: on_safety_task(task) for task in SAFETY_TASKS}, SAFETY)
    draw_ranks(RANKS)
