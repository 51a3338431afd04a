"""Draw the heat maps of results/, from the archives there.

python docs/_ext/heat_figures.py
"""

from __future__ import annotations

from pathlib import Path

from agents.reporting.maps import Column, heat_figure
from agents.reporting.pictures import write_picture
from agents.results.reading import Group, read_groups
from circle2d_mj import Circle2DConfig
from circle2d_mj.circle2d.view import Circle2DView

RESULTS = Path(__file__).parents[2] / "results"
PICTURES = RESULTS / "pictures"
SIZE = 400
PARTS = {
    "": "all parts",
    "-without-novelty": "without the bonus",
    "-without-horizon": "returns end at the time limit",
    "-without-streak": "without streak cost",
}
"""Titles by what stands behind "sac-lb-streak" in a folder's name."""
LEVELS = (0, 1)
ALGORITHMS = {
    "trpo-lag": "TRPO-Lag",
    "cpo": "CPO",
    "sac-lag": "SAC-Lag",
    "sac-lb": "SAC-LB",
    "wcsac": "WCSAC",
}
TASKS = {"Circle2D-{}-v0": "kinematic", "Circle2DMuJoCo-{}-v0": "with physics"}


def parts(solve: Path, picture: Path) -> None:
    """SAC-LB-Streak without some of its parts, first third of training, a column for each."""
    groups = by_folder(solve)
    columns, views = [], [Circle2DView(Circle2DConfig(level=level)) for level in LEVELS]
    for choice, title in PARTS.items():
        visits = [groups[f"Circle2D-{k}-v0-sac-lb-streak{choice}"].visits()[0] for k in LEVELS]
        columns.append(Column(title, views, visits))
    titles = [f"level {level}" for level in LEVELS]
    write_picture(picture, heat_figure(columns, titles, SIZE))


def physics(kinematic: Path, with_physics: Path, level: int, third: int, picture: Path) -> None:
    """The paper's algorithms without and with physics, in a third of training on a level."""
    groups = by_folder(kinematic) | by_folder(with_physics)
    views = [Circle2DView(Circle2DConfig(level=level))] * len(TASKS)
    columns = []
    for name, title in ALGORITHMS.items():
        both = [groups[f"{task.format(level)}/{name}"] for task in TASKS]
        columns.append(Column(title, views, [group.visits()[third] for group in both]))
    write_picture(picture, heat_figure(columns, list(TASKS.values()), SIZE))


def by_folder(archive: Path) -> dict[str, Group]:
    """The groups of an archive."""
    return {group.folder: group for group in read_groups([archive], [])}


if __name__ == "__main__":
    archives = {grid: RESULTS / grid / "runs.zip" for grid in ("circle2d", "solve", "physics")}
    parts(archives["solve"], PICTURES / "parts.png")
    physics(archives["circle2d"], archives["physics"], 3, 0, PICTURES / "physics.png")
    level_0 = RESULTS / "physics" / "level-0.zip"
    physics(archives["circle2d"], level_0, 0, 2, PICTURES / "physics-0.png")
