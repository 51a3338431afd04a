"""Draw the heat maps of results/pictures from the published archives.

python docs/_ext/heat_maps.py
"""

from __future__ import annotations

from pathlib import Path

from agents.algorithms import title
from agents.reporting.maps import HeatColumn, heat_figure
from agents.reporting.pictures import write_picture
from agents.results.groups import Group
from agents.results.reading import read_groups
from agents.training.environments import view_of
from emcc.parts import PARTS

RESULTS = Path(__file__).parents[2] / "results"
THIRDS = [f"{words} of training" for words in PARTS.values()]
FIVE = ("trpo-lag", "cpo", "sac-lag", "sac-lb", "wcsac")
SIZE = 320
"""Pixels along the side of a map."""


def group(archive: str, folder: str) -> Group:
    """Return the group of runs in a folder of an archive."""
    return read_groups([RESULTS / archive / folder], [])[0]


def column(title: str, cells: list[tuple[Group, int]]) -> HeatColumn:
    """Return a column of heat maps, of a group in one third of training each."""
    views = [view_of(own.task, own.config.task_parameters) for own, _ in cells]
    return HeatColumn(title, views, [own.visits()[third] for own, third in cells])


def write(name: str, columns: list[HeatColumn], rows: list[str]) -> None:
    """Write a picture."""
    write_picture(RESULTS / "pictures" / name, heat_figure(columns, rows, SIZE))


def write_physics(name: str, archive: str, level: int, third: int) -> None:
    """Write the picture of the five algorithms on a level, without physics and with it."""
    columns = []
    for own in FIVE:
        kinematic = group("circle2d/runs.zip", f"Circle2D-{level}-v0/{own}")
        physics = group(archive, f"Circle2DMuJoCo-{level}-v0/{own}")
        columns.append(column(title(own), [(kinematic, third), (physics, third)]))
    write(name, columns, ["kinematic", "with physics"])


def main() -> None:
    """Write all pictures."""
    columns = []
    for own in FIVE:
        runs = group("circle2d/runs.zip", f"Circle2D-1-v0/{own}")
        columns.append(column(title(own), [(runs, 0), (runs, 1), (runs, 2)]))
    write("level-1.png", columns, THIRDS)
    columns = []
    for archive, folder in (
        ("circle2d/runs.zip", "Circle2D-3-v0/trpo-lag"),
        ("solve/runs.zip", "Circle2D-3-v0-sac-lb-streak"),
    ):
        runs = group(archive, folder)
        columns.append(column(title(runs.config.algorithm), [(runs, 0), (runs, 2)]))
    write("level-3.png", columns, [THIRDS[0], THIRDS[2]])
    write_physics("physics.png", "physics/runs.zip", 3, 0)
    write_physics("physics-0.png", "physics/level-0.zip", 0, 2)


if __name__ == "__main__":
    main()
