"""Maps of runs: where agents were in training, and the paths of trained policies."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.errors import UserError
from agents.paper.settings import in_order, name_of
from agents.reporting.figures import visits_words
from agents.reporting.scenes import STATES, Scene, Scenes, heat_png, paths
from agents.results.measures import measure
from agents.results.reading import DamagedSource, Group, Run
from agents.results.steps import DRAWN, DRAWN_POLICIES, Episode
from circle2d_mj.render import canvas
from emcc.parts import ALPHA, PARTS


class Map(NamedTuple):
    """A picture in layers: heat or paths, between what is below and on top."""

    scene: Scene
    words: str
    """Below it."""
    heat: bytes = b""
    """See `scenes.heat_png`."""
    way: str = ""
    costs: str = ""
    """See `scenes.paths`."""


class Maps(NamedTuple):
    """Maps side by side, a column for each algorithm; of a single one a row."""

    title: str
    caption: str
    columns: Sequence[str]
    rows: Sequence[str]
    cells: Sequence[Sequence[Map | str]]
    """Row by row; words where there is nothing to draw."""
    most_visits: int | None = None
    """Visits that the last colour of heat stands for."""


def maps(groups: Sequence[Group], scenes: Scenes, notes: list[str]) -> list[Maps]:
    """The maps of one task; none of a task without a view.

    groups: its runs. What cannot be drawn goes into the notes.
    """
    seen = [
        (g, scene) for g in in_order(groups) if g.runs and (scene := scenes.of(g.config, notes))
    ]
    found = [_visited(seen, notes), _trained(seen, notes)]
    return [_turned(shown) if len(shown.columns) == 1 else shown for shown in found if shown]


def _turned(shown: Maps) -> Maps:
    """The maps with rows and columns exchanged: those of one algorithm fit side by side."""
    cells = list(zip(*shown.cells, strict=True))
    return shown._replace(columns=shown.rows, rows=shown.columns, cells=cells)


def _visited(seen: Sequence[tuple[Group, Scene]], notes: list[str]) -> Maps | None:
    """A row for each third of training; one scale for all."""
    names: list[str] = []
    columns: list[list[tuple[Scene, str, NDArray[np.int64]]]] = []
    for group, scene in seen:
        try:
            parts = group.visits()
        except DamagedSource:
            raise
        except UserError as error:
            notes.append(f"no heat map of {group.title}: {error}")
            continue
        names.append(name_of(group))
        columns.append([(scene, visits_words(of), _coarser(of.counts)) for of in parts])
    if not columns:
        return None
    most = canvas.most_visits([counts for column in columns for *_, counts in column])
    cells = [
        [Map(scene, words, heat_png(counts, most)) for scene, words, counts in row]
        for row in zip(*columns, strict=True)
    ]
    words = (
        "States visited in the rollouts that dominate EMCC in each third of training (the share "
        f"α = {ALPHA:g} with the highest MCC, and all that equal the last of them), of all seeds "
        "together. One scale for all maps; its darkest colour stands for as many visits as "
        f"{100 * canvas.QUANTILE:.0f} % of the visited cells do not exceed. EMCC: mean over seeds."
    )
    rows = [f"{part} of training" for part in PARTS.values()]
    return Maps("Visited states", words, names, rows, cells, most)


def _coarser(counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Counts of cells of twice the side: on a page the smaller ones are a pixel or two."""
    half = len(counts) // 2
    return counts.reshape(half, 2, half, 2).sum(axis=(1, 3))


def _trained(seen: Sequence[tuple[Group, Scene]], notes: list[str]) -> Maps | None:
    """A row for each run."""
    names: list[str] = []
    columns: list[list[Map | str]] = []
    for group, scene in seen:
        runs = group.runs[:DRAWN_POLICIES]
        try:
            played = group.trained([run.seed for run in runs])
        except DamagedSource:
            raise
        except UserError as error:
            notes.append(f"no trajectories of {group.title}: {error}")
            continue
        names.append(name_of(group))
        columns.append([_map(run, played[run.seed], scene) for run in runs])
    if not any(isinstance(cell, Map) for column in columns for cell in column):
        return None
    most = max(map(len, columns))
    rows = zip(*(column + [""] * (most - len(column)) for column in columns), strict=True)
    words = (
        f"The first {DRAWN} episodes of each trained policy's evaluation (deterministic): a dot "
        "for each state, an orange square where the step there cost. Of episodes above "
        f"{STATES} steps every second, third, ... state is drawn. J_R, J_C: return and cost of an "
        "episode, means of the whole evaluation."
    )
    heads = [f"run {k + 1}" for k in range(most)]
    return Maps("Trained policies", words, names, heads, list(rows))


def _map(run: Run, episodes: Sequence[Episode] | None, scene: Scene) -> Map | str:
    """The episodes of a run's policy; words for one that diverged."""
    named = [(measure(name), run.measures[name]) for name in ("J_R", "J_C")]
    words = ", ".join(f"{of.title} {value:.1f}" for of, value in named if value is not None)
    if episodes is None:
        return f"seed {run.seed}: {words}; its numbers are not finite"
    way, costs = paths(scene, episodes)
    return Map(scene, f"seed {run.seed}: {words}", way=way, costs=costs)
