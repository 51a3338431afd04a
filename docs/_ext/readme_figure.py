"""Draw figures from reports' numbers: cost rate against EMCC, a dot for each run, and the
benchmark's ranks by either.

python docs/_ext/readme_figure.py
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from results_table import BENCHMARK_STEPS, baseline_ranks, mean_rank

from agents.algorithms import ALGORITHMS
from agents.reporting.figures import COLOURS, MARKERS

RESULTS = Path(__file__).parents[2] / "results"
REPORTS = tuple(RESULTS / grid / "report.csv" for grid in ("circle2d", "solve"))
PICTURE = RESULTS / "pictures" / "cost-rate-emcc.png"
GOAL = RESULTS / "pictures" / "point-goal.png"
RANKS = RESULTS / "pictures" / "ranks.png"
APART = 0.55
"""Ranks between two names, at least, so that they can be read."""

ORDER = [algorithm.title for algorithm in ALGORITHMS.values()]


def look(name: str) -> dict[str, str]:
    """Colour and marker of an algorithm in reports."""
    place = ORDER.index(name)
    return {"color": COLOURS[place % len(COLOURS)], "marker": MARKERS[place % len(MARKERS)]}


def runs(paths: Sequence[Path]) -> dict[str, list[tuple[float, float]]]:
    """Cost rate and EMCC of the last third for each run of the presets, by algorithm."""
    found: dict[str, list[tuple[float, float]]] = {}
    for path in paths:
        with path.open(encoding="utf-8") as file:
            for row in csv.DictReader(file):
                name = row["algorithm"].removesuffix(BENCHMARK_STEPS)
                if row["seed"] and "(" not in name:
                    point = float(row["cost_rate"]), float(row["EMCC_0.99"])
                    found.setdefault(name, []).append(point)
    return found


def draw(paths: Sequence[Path], picture: Path) -> None:
    """Write the figure, in the colours and markers of reports."""
    figure, axes = plt.subplots(figsize=(7, 3.6))
    found = runs(paths)
    for name in sorted(found, key=ORDER.index):
        axes.plot(
            *zip(*found[name], strict=True),
            linestyle="",
            **look(name),
            markersize=6,
            alpha=0.8,
            markeredgewidth=0,
            label=name,
        )
    axes.set(xlabel="cost rate (cost a step, all of training)", ylabel="EMCC, last third")
    axes.set(xlim=(0, None), ylim=(0, None))
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    figure.savefig(picture, dpi=110, bbox_inches="tight")


def draw_ranks(picture: Path) -> None:
    """Write the benchmark's mean ranks by the cost rate, left, and by late EMCC, right, a line for
    each algorithm."""
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
    """The heights moved down where they would be closer than `APART` to the one above."""
    moved, last = list(heights), -np.inf
    for k in np.argsort(heights, kind="stable"):
        moved[k] = last = max(heights[k], last + APART)
    return moved


if __name__ == "__main__":
    draw(REPORTS, PICTURE)
    draw([RESULTS / "baselines" / "safety" / "report.csv"], GOAL)
    draw_ranks(RANKS)
