"""Draw where SAC-LB-Streak goes without some of its parts, from the archive of results/solve.

python docs/_ext/parts_figure.py
"""

from __future__ import annotations

from pathlib import Path

from agents.reporting.figures import Ground, visits_words
from agents.reporting.image_files import write_picture
from agents.results.archive import open_source
from agents.results.reading import read_groups
from circle2d_mj import Circle2DConfig
from circle2d_mj.circle2d.view import Circle2DView
from circle2d_mj.render import canvas
from circle2d_mj.render.figure import figure

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
    source = open_source(archive)
    groups = {group.folder: group for group in read_groups(source, [])}
    rows = []
    for level in LEVELS:
        own = [groups[f"Circle2D-{level}-v0-sac-lb-streak{choice}"] for choice in COLUMNS]
        records = [{run.seed: run.records for run in group.runs} for group in own]
        pairs = zip(own, records, strict=True)
        rows.append([source.visits(group.folder, group.config, of)[0] for group, of in pairs])
    most = canvas.most_visits([visits.counts for row in rows for visits in row])
    views = [Circle2DView(Circle2DConfig(level=level)) for level in LEVELS]
    grounds = [Ground(view, view.background(SIZE)) for view in views]
    pairs = list(zip(grounds, rows, strict=True))
    maps = [[ground.heatmap(visits, most) for visits in row] for ground, row in pairs]
    drawn = figure(
        maps,
        list(COLUMNS.values()),
        row_titles=[f"level {level}" for level in LEVELS],
        captions=[[visits_words(visits) for visits in row] for row in rows],
        most_visits=most,
    )
    write_picture(picture, drawn)


if __name__ == "__main__":
    draw(ARCHIVE, PICTURE)
