"""Draw where SAC-LB-Streak goes without some of its parts, from the archive of results/solve.

python docs/_ext/parts_figure.py
"""

from __future__ import annotations

from pathlib import Path

from agents.reporting.maps import Column, heat_figure
from agents.reporting.pictures import write_picture
from agents.results.reading import read
from circle2d_mj import Circle2DConfig
from circle2d_mj.circle2d.view import Circle2DView

RESULTS = Path(__file__).parents[2] / "results"
ARCHIVE = RESULTS / "solve" / "runs.zip"
PICTURE = RESULTS / "pictures" / "parts.png"
SIZE = 480
COLUMNS = {
    "": "all parts",
    "-without-novelty": "without the bonus",
    "-without-horizon": "returns end at the time limit",
    "-without-streak": "without streak cost",
}
"""Titles by what stands behind "sac-lb-streak" in a folder's name."""
LEVELS = (0, 1)


def draw(archive: Path, picture: Path) -> None:
    """Write heat maps of the first third of training, a column for each choice."""
    groups = {group.folder: group for group in read([archive], [])}
    columns, views = [], [Circle2DView(Circle2DConfig(level=level)) for level in LEVELS]
    for choice, title in COLUMNS.items():
        visits = [groups[f"Circle2D-{k}-v0-sac-lb-streak{choice}"].visits()[0] for k in LEVELS]
        columns.append(Column(title, views, visits))
    titles = [f"level {level}" for level in LEVELS]
    write_picture(picture, heat_figure(columns, titles, SIZE))


if __name__ == "__main__":
    draw(ARCHIVE, PICTURE)
