"""Maps of runs: heat maps of states visited in training, paths of trained policies, and the replay
of training.

The page holds a background and an overlay once for each task; the layer between them is an image
with a pixel for each cell, or an SVG path in thousandths of the picture's side. The replay has, for
every run, the episode with the highest MCC in each window of training, and the running EMCC.
Positions are on a grid of 1024 points along each side of the box around them, EMCC has three
digits; everything else is exact. The page's script, `templates/replay.js`, reads these data.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from agents.errors import UserError
from agents.reporting.figures import emcc_along
from agents.results.groups import Episode, Group, Highlights, RunResult
from agents.results.measures import measure
from agents.results.names import in_order
from agents.results.reading import left_out
from agents.training.derive import BITS, DRAWN_POLICIES, STATES, WINDOWS, Drawn, Visits
from agents.training.environments import view_of
from agents.training.evaluation import DRAWN
from circle2d_mj.core.view import Extent, Picture, View
from circle2d_mj.render import canvas
from circle2d_mj.render.figure import figure
from emcc.parts import ALPHA, PARTS

SCENE_SIZE = 360
"""Pixels along the side of backgrounds and overlays."""
SIDE = 1000
"""Side of a picture in the units of its SVG paths."""
SHADES = 31
"""Number of colours of a heat map."""
NO_POSITIONS = "it has no positions"
DIGITS = 1000
"""EMCC is stored as a multiple of 1 / DIGITS."""
REPLAYED = 200
"""Most runs in a replay: each adds 12 kB to the page."""


class Ground(NamedTuple):
    """A task's view and the background to draw on."""

    view: View
    background: Picture

    def heatmap(self, visits: Visits, most: int) -> Picture:
        """Draw visited states. most: number of visits that the last colour stands for."""
        return self.view.overlay(canvas.with_counts(self.background, visits.counts, most))

    def trajectories(self, episodes: Sequence[Episode], boxed: bool) -> Picture:
        """Draw episodes, a dot for each state. boxed: see `canvas.with_trajectories`."""
        paths, costs = zip(*episodes, strict=True)
        extent = self.view.extent
        picture = canvas.with_trajectories(self.background, extent, paths, costs, boxed=boxed)
        return self.view.overlay(picture)


class HeatColumn(NamedTuple):
    """A column of heat maps: states that runs visited in parts of training, or on several tasks."""

    title: str
    views: Sequence[View]
    """The task's view for each part."""
    parts: Sequence[Visits]


def heat_figure(columns: Sequence[HeatColumn], titles: Sequence[str], size: int) -> Picture:
    """Draw heat maps with one scale; the maps of a single column are placed side by side.

    titles: of the parts, the rows; size: pixels along the side of each map.
    """
    most = canvas.most_visits([part.counts for column in columns for part in column.parts])
    pictures = [
        [
            Ground(view, view.background(size)).heatmap(part, most)
            for view, part in zip(column.views, column.parts, strict=True)
        ]
        for column in columns
    ]
    captions = [[visits_words(part) for part in column.parts] for column in columns]
    names = [column.title for column in columns]
    if len(columns) == 1:
        return figure(pictures, titles, title=names[0], captions=captions, most_visits=most)
    rows, words = list(zip(*pictures, strict=True)), list(zip(*captions, strict=True))
    return figure(rows, names, row_titles=titles, captions=words, most_visits=most)


def visits_words(visits: Visits) -> str:
    """Return the line below a heat map."""
    return f"EMCC {visits.emcc:.2f} ({visits.rollouts:,} of {visits.of:,} rollouts)"


def png(picture: Picture | Image.Image, **how: Any) -> bytes:
    """Return the picture as a small lossless PNG. how: options of Pillow."""
    image = picture if isinstance(picture, Image.Image) else Image.fromarray(picture)
    image.save(file := io.BytesIO(), "PNG", **({"optimize": True} | how))
    return file.getvalue()


def heat_png(counts: NDArray[np.int64], most: int) -> bytes:
    """Return the heat map of visits as a PNG, a pixel per cell; unvisited cells are transparent.

    counts: [cells, cells]; most: see `canvas.with_counts`.
    """
    shade = 1 + np.round(canvas.heat_share(counts, most) * (SHADES - 1))
    image = Image.fromarray(np.where(counts > 0, shade, 0).astype(np.uint8), "P")
    colours = canvas.heat_colours(np.linspace(0.0, 1.0, SHADES))
    image.putpalette([0, 0, 0, *colours.ravel().tolist()])
    return png(image, transparency=0)


class Scene(NamedTuple):
    """The background and overlay that all pictures of a task share."""

    number: int
    """Index among the scenes of the page."""
    extent: Extent
    """Left, right, bottom and top in the view's unit."""
    below: bytes
    """Background, PNG."""
    above: bytes
    """Overlay, PNG with transparency."""


class Scenes:
    """The scenes of tasks, each created on first use."""

    def __init__(self) -> None:
        self._made: dict[str, Scene | None] = {}

    def get(self, group: Group, notes: list[str]) -> Scene | None:
        """Return the scene of a group's task; None for a task without a view.

        If the view cannot be made, it adds a note and returns None."""
        task, parameters = group.task, group.config.task_parameters
        key = repr((task, parameters))
        if key not in self._made:
            self._made[key] = None
            try:
                view = view_of(task, parameters)
            except UserError as error:
                notes.append(f"no pictures of {task}: {error}")
            else:
                self._made[key] = None if view is None else _scene(len(self.all), view)
        return self._made[key]

    @property
    def all(self) -> list[Scene]:
        """All scenes created so far, by number."""
        return [scene for scene in self._made.values() if scene]


def _scene(number: int, view: View) -> Scene:
    # The overlay covers light and dark alike, so their difference shows how opaque it is.
    light, dark = (
        view.overlay(np.full((SCENE_SIZE, SCENE_SIZE, 3), shade, np.uint8)).astype(np.float64)
        for shade in (255, 0)
    )
    cover = 1.0 - np.clip(light - dark, 0, 255).mean(axis=-1, keepdims=True) / 255
    colour = np.clip(dark / np.maximum(cover, 1 / 255), 0, 255)
    above = np.concatenate((colour, 255 * cover), axis=-1).round().astype(np.uint8)
    return Scene(number, view.extent, png(view.background(SCENE_SIZE)), png(above))


class Map(NamedTuple):
    """A picture in layers: a heat map or paths between background and overlay."""

    scene: Scene
    words: str
    """The line below the picture."""
    heat: bytes = b""
    """PNG from `heat_png`."""
    way: str = ""
    costs: str = ""
    """SVG paths from `paths`."""


class Maps(NamedTuple):
    """A grid of maps with a column for each algorithm; the maps of a single algorithm are a row."""

    title: str
    caption: str
    columns: Sequence[str]
    rows: Sequence[str]
    cells: Sequence[Sequence[Map | str]]
    """Row by row; a string where there is nothing to draw."""
    most_visits: int | None = None
    """Number of visits that the last colour of heat maps stands for."""


def maps(groups: Sequence[Group], scenes: Scenes, notes: list[str]) -> list[Maps]:
    """Draw the maps of one task; empty for a task without a view.

    groups: the task's runs. Adds a note on each map that cannot be drawn.
    """
    complete = [group for group in in_order(groups) if group.runs]
    seen = [(g, scene) for g in complete if (scene := scenes.get(g, notes))]
    drawn = [_visited(seen, notes), _trained(seen, notes)]
    return [_turned(shown) if len(shown.columns) == 1 else shown for shown in drawn if shown]


def _turned(shown: Maps) -> Maps:
    """Transpose the grid, so that the maps of a single algorithm are side by side."""
    cells = list(zip(*shown.cells, strict=True))
    return shown._replace(columns=shown.rows, rows=shown.columns, cells=cells)


def _visited(seen: Sequence[tuple[Group, Scene]], notes: list[str]) -> Maps | None:
    """Draw the states visited in training: a row for each third, one scale for all."""
    names: list[str] = []
    columns: list[list[tuple[Scene, str, NDArray[np.int64]]]] = []
    for group, scene in seen:
        try:
            parts = group.visits()
        except UserError as error:
            notes.append(left_out("heat map", [group], error))
            continue
        if parts is None:
            why = f"{NO_POSITIONS}, or a third of its training no rollout"
            notes.append(f"no heat map of {group.title}: {why}")
            continue
        names.append(group.name)
        columns.append([(scene, visits_words(part), part.counts) for part in parts])
    if not columns:
        return None
    most = canvas.most_visits([counts for column in columns for *_, counts in column])
    cells = [
        [Map(scene, words, heat_png(counts, most)) for scene, words, counts in row]
        for row in zip(*columns, strict=True)
    ]
    words = (
        "States visited in the rollouts that dominate EMCC in each third of training (the share "
        f"α = {ALPHA:g} with the highest MCC), all seeds together, on one scale. EMCC: mean over "
        "seeds."
    )
    rows = [f"{part} of training" for part in PARTS.values()]
    return Maps("Visited states", words, names, rows, cells, most)


def _trained(seen: Sequence[tuple[Group, Scene]], notes: list[str]) -> Maps | None:
    """Draw the paths of trained policies: a row for each run."""
    names: list[str] = []
    columns: list[list[Map | str]] = []
    for group, scene in seen:
        column: list[Map | str] = []
        for run in group.runs[:DRAWN_POLICIES]:
            try:
                played = run.trained()
            except UserError as error:
                notes.append(left_out(f"trajectories of seed {run.seed}", [group], error))
                continue
            if played is None:
                notes.append(f"no trajectories of {group.title}: {NO_POSITIONS}")
                break
            column.append(_map(run, played, scene))
        if column:
            names.append(group.name)
            columns.append(column)
    if not columns:
        return None
    most = max(map(len, columns))
    rows = zip(*(column + [""] * (most - len(column)) for column in columns), strict=True)
    words = (
        f"The first {DRAWN} episodes of each trained policy's evaluation (deterministic): a dot "
        f"for each state (of more than {STATES}, every second, third, ...), an orange square where "
        "the step there cost. J_R, J_C: means of the whole evaluation."
    )
    heads = [f"run {k + 1}" for k in range(most)]
    return Maps("Trained policies", words, names, heads, list(rows))


def _map(run: RunResult, episodes: Sequence[Drawn], scene: Scene) -> Map:
    """Draw the episodes of a run's trained policy."""
    named = [(measure(name), run.measures[name]) for name in ("J_R", "J_C")]
    words = ", ".join(f"{m.title} {value:.1f}" for m, value in named if value is not None)
    way, costs = paths(scene.extent, episodes)
    return Map(scene, f"seed {run.seed}: {words}", way=way, costs=costs)


def paths(extent: Extent, episodes: Sequence[Drawn]) -> tuple[str, str]:
    """Return two SVG paths: lines through the drawn states of each episode, and a point at each
    drawn state where a step cost, or that stands for such a state."""
    ways, costly = [], []
    for positions, unsafe in episodes:
        points = np.round(canvas.pixels(extent, positions, SIDE)).astype(np.int64)
        ways.append(f"M{_line(points)}")
        costly += [f"M{x} {y}h0" for x, y in points[unsafe].tolist()]
    return "".join(ways), "".join(costly)


def _line(points: NDArray[np.int64]) -> str:
    """Return points as a relative SVG path, half as long as an absolute one."""
    (x, y), *steps = [points[0].tolist(), *np.diff(points, axis=0).tolist()]
    return f"{x} {y}l" + " ".join(f"{dx} {dy}" for dx, dy in steps) if steps else f"{x} {y}h0"


def replay_data(groups: Sequence[Group], scenes: Scenes, notes: list[str]) -> dict[str, Any]:
    """Return the data of the replay; its "runs" is empty if no run has positions and costs.

    The replay shows the first `DRAWN_POLICIES` seeds of each group, or fewer if that would be more
    than `REPLAYED` runs. For tasks with a view, adds notes on what cannot be replayed.
    """
    runs, most = [], min(DRAWN_POLICIES, max(1, REPLAYED // max(1, len(groups))))
    if any(len(group.runs) > most for group in groups):
        notes.append(f"seeds of each algorithm in the replay: {most}")
    for group in in_order(groups):
        scene = scenes.get(group, notes) if group.runs else None
        if scene is None:
            continue
        named = {"task": group.task, "algorithm": group.name}
        for run in group.runs[:most]:
            try:
                replay = run.replay()
            except UserError as error:
                notes.append(left_out(f"replay of seed {run.seed}", [group], error))
                continue
            if replay is None:
                notes.append(f"no replay of {group.title}: {NO_POSITIONS}")
                break
            runs.append({**named, "scene": scene.number, **_run(run, replay)})
    extents = [list(scene.extent) for scene in scenes.all]
    return {
        "windows": WINDOWS,
        "bits": BITS,
        "digits": DIGITS,
        "states": STATES,
        "parts": list(PARTS),
        "extents": extents,
        "runs": runs,
    }


def _run(run: RunResult, replay: Highlights) -> dict[str, Any]:
    """Return a run's entry: numbers of each episode, then all points and costs."""
    episodes, steps = replay.episodes, run.replay_steps
    lengths = episodes.length.tolist()
    return {
        "seed": run.seed,
        "steps": steps,
        "box": replay.box.ravel().tolist(),
        "window": replay.windows,
        "start": episodes.start_step.tolist(),
        # A single length if all episodes have it, and no costs if each cost step costs 1.
        "length": lengths[0] if len(set(lengths)) == 1 else lengths,
        "cost": None if (episodes.cost == episodes.cost_steps).all() else episodes.cost.tolist(),
        "points": _text(_packed(replay.points)),
        "unsafe": _text(np.packbits(replay.unsafe)),
        "emcc": [
            None if np.isnan(value) else round(value * DIGITS)
            for value in emcc_along(run.rollouts, steps)
        ],
    }


def _packed(points: NDArray[np.uint16]) -> NDArray[np.uint8]:
    """Pack points [N, 2]: x and y of each point in turn, `BITS` bits each."""
    return np.packbits(points.reshape(-1, 1) >> np.arange(BITS)[::-1] & 1)


def _text(data: NDArray[np.uint8]) -> str:
    return base64.b64encode(data.tobytes()).decode()
