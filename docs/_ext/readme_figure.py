"""Draw the README's figure, cost rate against EMCC a dot for each run, from a report's numbers.

python docs/_ext/readme_figure.py [REPORT.csv [PICTURE.png]]
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import matplotlib.pyplot as plt

ROOT = Path(__file__).parents[2]
REPORT = ROOT / "results" / "circle2d" / "report.csv"
PICTURE = ROOT / "results" / "pictures" / "cost-rate-emcc.png"
MARKS = "osD^v<>P*X"
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Okabe and Ito's, for readers with colour deficiencies."""


def runs(path: Path) -> dict[str, list[tuple[float, float]]]:
    """Cost rate and EMCC of the last third for each run of the presets, by algorithm."""
    found: dict[str, list[tuple[float, float]]] = {}
    with path.open(encoding="utf-8") as file:
        for row in csv.DictReader(file):
            if row["seed"] and "(" not in row["algorithm"]:
                point = float(row["cost_rate"]), float(row["EMCC_0.99"])
                found.setdefault(row["algorithm"], []).append(point)
    return found


def draw(path: Path, picture: Path) -> None:
    """Write the figure."""
    figure, axes = plt.subplots(figsize=(7, 3.6))
    for k, (name, points) in enumerate(runs(path).items()):
        axes.plot(
            *zip(*points, strict=True),
            MARKS[k % len(MARKS)],
            color=COLOURS[k % len(COLOURS)],
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
    given = [Path(argument) for argument in sys.argv[1:]]
    draw(*given, *(REPORT, PICTURE)[len(given) :])
