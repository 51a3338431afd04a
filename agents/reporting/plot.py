"""Learning curves for a paper: one figure, a row for each task and a column for each measure."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from agents.errors import UserError, nearest
from agents.reporting.figures import ALONG, draw_along, drawing
from agents.results.groups import Group
from agents.results.measures import measures as registered
from agents.results.names import by_task, with_names
from agents.results.reading import LeftOut, read_groups
from agents.results.statistics import INTERVALS
from agents.training.files import check_file, write_whole
from emcc.parts import ALPHA
from emcc.statistics import FEWEST_RUNS

SUFFIXES = (".pdf", ".svg", ".png", ".pgf")
"""Allowed file formats; .pgf, drawing commands for LaTeX, needs xelatex."""


class Plot(NamedTuple):
    """A figure that was drawn."""

    caption: str
    left_out: list[LeftOut]
    """Folders and runs that were left out, and why."""

    @property
    def words(self) -> str:
        """The caption and the notes on what was left out."""
        return " ".join([self.caption, *(f"{note}." for note in self.left_out)])


def plot(
    paths: Sequence[Path],
    out: Path,
    measures: Sequence[str] = ("return", "cost", "emcc"),
    names: Mapping[str, str] | None = None,
    colours: Mapping[str, str] | None = None,
    width: float = 5.5,
) -> Plot:
    """Draw the figure into a file: see `agents.plot`."""
    from matplotlib.colors import is_color_like

    if out.suffix.lower() not in SUFFIXES:
        raise UserError(f"out must end in {', '.join(SUFFIXES)}, got {str(out)!r}")
    check_file(out)
    if unknown := [name for name in measures if name not in ALONG]:
        words = f"measure {unknown[0]!r} cannot be drawn: {nearest(unknown[0], ALONG)}"
        if unknown[0] in [m.name for m in registered()]:
            words += "; it is a number of a whole run: see the report's figure of every run"
        raise UserError(words)
    if not measures:
        raise UserError(f"plot needs a measure: {', '.join(ALONG)}")
    notes: list[str] = []
    tasks = by_task(with_names(read_groups(paths, notes)))
    left_out = [note for note in notes if isinstance(note, LeftOut)]
    if not tasks:
        raise UserError("; ".join(["no run is complete", *left_out]))
    entries = list(dict.fromkeys(group.name for own in tasks.values() for group in own))
    shown = _given("names", names, entries)
    colour_of = _given("colours", colours, entries)
    if wrong := [colour for colour in colour_of.values() if not is_color_like(colour)]:
        raise UserError(f"colours: {wrong[0]!r} is no colour of matplotlib, such as #0072B2 or C0")
    named = {task: [(shown.get(g.name, g.name), g) for g in own] for task, own in tasks.items()}
    with drawing(8) as pyplot:
        # Text stays text in both formats; journals refuse type 3, matplotlib's default in PDF.
        pyplot.rcParams.update({"pdf.fonttype": 42, "svg.fonttype": "none", "axes.linewidth": 0.6})
        figure = draw_along(pyplot, named, measures, width, colour_of)
        _save(figure, out)
        pyplot.close(figure)
    return Plot(_caption(tasks, measures), left_out)


def _given(what: str, given: Mapping[str, str] | None, entries: Sequence[str]) -> dict[str, str]:
    """Return a user's values by entry of the legend. The name of an algorithm with only one curve
    may stand for the entry. Raises UserError for an unknown name; what: the option's name."""
    found = {}
    for name, value in (given or {}).items():
        called = [entry for entry in entries if entry == name]
        called = called or [entry for entry in entries if entry.partition(" (")[0] == name]
        if len(called) != 1:
            raise UserError(f"{what}: no curve is called {name!r}: {nearest(name, entries)}")
        found[called[0]] = value
    return found


def _save(figure: Any, out: Path) -> None:
    kind = out.suffix.lower()[1:]
    dates = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}  # equal runs give equal files
    more = {"metadata": dates[kind]} if kind in dates else {}
    file = io.StringIO() if kind == "pgf" else io.BytesIO()
    try:
        figure.savefig(file, format=kind, dpi=300, **more)
    except FileNotFoundError as error:
        if error.filename != "xelatex":
            raise
        words = f"{out.name} needs xelatex, which is not installed; a .pdf does not"
        raise UserError(words) from error
    content = file.getvalue()
    out.parent.mkdir(parents=True, exist_ok=True)
    write_whole(out, content.encode() if isinstance(content, str) else content)


def _caption(tasks: Mapping[str, Sequence[Group]], measures: Sequence[str]) -> str:
    seeds = {len(group.runs) for groups in tasks.values() for group in groups}
    runs = " to ".join(map(str, sorted({min(seeds), max(seeds)})))
    # Brackets mark intervals only in tables.
    areas = INTERVALS.translate({ord("["): "", ord("]"): ""})
    areas = "their range" if max(seeds) < FEWEST_RUNS else areas
    words = f"Training's episodes. Lines: mean over {runs} seeds; areas: {areas}."
    if "emcc" in measures:
        words += f" EMCC: α = {ALPHA:g}, in a window of a tenth of training."
    return words
