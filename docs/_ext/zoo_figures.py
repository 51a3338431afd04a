"""Draw the learning curves of results/zoo from its tables.

python docs/_ext/zoo_figures.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from agents.presets import limit_of
from agents.reporting.figures import drawing

FOLDER = Path(__file__).parents[2] / "results/zoo"
COLUMNS = 4
OURS, PUBLISHED = "#0072B2", "#D55E00"
DASHED = {"color": PUBLISHED, "linewidth": 1.0, "linestyle": "--"}


def short(task: str) -> str:
    """Return a task's name without "Safety" and the version."""
    return task.removeprefix("Safety").rpartition("-")[0]


def draw_curves(rows: pd.DataFrame, curves: pd.DataFrame) -> None:
    """Draw return and cost in training, two panels per task."""
    from matplotlib.ticker import EngFormatter

    columns = min(COLUMNS, len(rows))
    lines = -(-len(rows) // columns)
    with drawing(8) as pyplot:
        figure, axes = pyplot.subplots(
            2 * lines,
            columns,
            figsize=(7.5, 2.9 * lines + 0.3),
            layout="constrained",
            squeeze=False,
        )
        for axis in axes.flat:
            axis.set_visible(False)
        for k, row in enumerate(rows.itertuples()):
            own = curves[curves.task == row.task]
            line, column = divmod(k, columns)
            upper, lower = axes[2 * line, column], axes[2 * line + 1, column]
            for axis, name in ((upper, "return"), (lower, "cost")):
                axis.set_visible(True)
                axis.plot(own.step, own[f"{name}_mean"], color=OURS, label="the zoo, five seeds")
                low, high = own[f"{name}_min"], own[f"{name}_max"]
                axis.fill_between(own.step, low, high, color=OURS, alpha=0.2, linewidth=0)
                axis.set_xlim(0, row.steps)
                axis.xaxis.set_major_formatter(EngFormatter(sep=""))
                axis.spines[["top", "right"]].set_visible(False)
                if column == 0:
                    axis.set_ylabel(name)
            if np.isfinite(row.published_J_R):
                upper.axhline(row.published_J_R, **DASHED, label="OmniSafe's best within the limit")
            upper.set_title(short(row.task), fontsize=8)
            upper.tick_params(labelbottom=False)
            limit = limit_of(row.task)
            lower.axhline(limit, color="#666666", linewidth=1.0, linestyle=":", label="cost limit")
            lower.set_ylim(0, max(2.4 * limit, 1.5 * own.cost_mean[len(own) // 5 :].max()))
            lower.set_xlabel("environment steps")
        parts = [axis.get_legend_handles_labels() for axis in axes.flat]
        handles = {label: handle for part in parts for handle, label in zip(*part, strict=True)}
        figure.legend(handles.values(), handles, ncols=3, loc="outside lower center", frameon=False)
        figure.savefig(FOLDER / "curves.png", dpi=160)
        pyplot.close(figure)


if __name__ == "__main__":
    draw_curves(*(pd.read_csv(FOLDER / name) for name in ("zoo.csv", "curves.csv")))
