"""Draw the README's figure, cost rate against EMCC a dot for each run, from reports' numbers.

python docs/_ext/readme_figure.py
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt

from agents.algorithms import ALGORITHMS
from agents.reporting.figures import COLOURS, MARKERS

RESULTS = Path(__file__).parents[2] / "results"
REPORTS = tuple(RESULTS / grid / "report.csv" for grid in ("circle2d", "solve"))
PICTURE = RESULTS / "pictures" / "cost-rate-emcc.png"


def runs(paths: Sequence[Path]) -> dict[str, list[tuple[float, float]]]:
    """Cost rate and EMCC of the last third for each run of the presets, by algorithm."""
    found: dict[str, list[tuple[float, float]]] = {}
    for path in paths:
        with path.open(encoding="utf-8") as file:
            for row in csv.DictReader(file):
                if row["seed"] and "(" not in row["algorithm"]:
                    point = float(row["cost_rate"]), float(row["EMCC_0.99"])
                    found.setdefault(row["algorithm"], []).append(point)
    return found


def draw(paths: Sequence[Path], picture: Path) -> None:
    """Write the figure, in the colours and markers of reports."""
    order = [algorithm.title for algorithm in ALGORITHMS.values()]
    figure, axes = plt.subplots(figsize=(7, 3.6))
    found = runs(paths)
    for name in sorted(found, key=order.index):
        place = order.index(name)
        axes.plot(
            *zip(*found[name], strict=True),
            MARKERS[place % len(MARKERS)],
            color=COLOURS[place % len(COLOURS)],
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


if __name__ == "__main__":
    draw(REPORTS, PICTURE)
