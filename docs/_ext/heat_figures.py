"""Draw the heat maps of results/physics from the archives.

python docs/_ext/heat_figures.py
"""

from __future__ import annotations

from pathlib import Path

from agents import algorithms
from agents.paper.grid import PAPER_ALGORITHMS
from agents.reporting.maps import HeatColumn, heat_figure
from agents.reporting.pictures import write_picture
from agents.results.groups import Group
from agents.results.reading import read_groups
from circle2d_mj import Circle2DConfig
from circle2d_mj.circle2d.view import Circle2DView

RESULTS = Path(__file__).parents[2] / "results"
PICTURES = RESULTS / "pictures"
SIZE = 400
TASKS = {"Circle2D-{}-v0": "kinematic", "Circle2DMuJoCo-{}-v0": "with physics"}


def physics(kinematic: Path, with_physics: Path, level: int, third: int, picture: Path) -> None:
    """Draw the paper's algorithms without and with physics, in a third of training on a level."""
    groups = by_folder(kinematic) | by_folder(with_physics)
    views = [Circle2DView(Circle2DConfig(level=level))] * len(TASKS)
    columns = []
    for name in PAPER_ALGORITHMS:
        both = [groups[f"{task.format(level)}/{name}"] for task in TASKS]
        visits = [group.visits()[third] for group in both]
        columns.append(HeatColumn(algorithms.title(name), views, visits))
    write_picture(picture, heat_figure(columns, list(TASKS.values()), SIZE))


def by_folder(archive: Path) -> dict[str, Group]:
    """Return the groups of an archive by folder."""
    return {group.folder: group for group in read_groups([archive], [])}


if __name__ == "__main__":
    kinematic, own = RESULTS / "circle2d" / "runs.zip", RESULTS / "physics"
    physics(kinematic, own / "runs.zip", 3, 0, PICTURES / "physics.png")
    physics(kinematic, own / "level-0.zip", 0, 2, PICTURES / "physics-0.png")
