"""Learning curves for a paper: one figure, a row for each task and a column for each measure."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from agents.errors import UserError, nearest
from agents.reporting.figures import (
    BELOW,
    Curve,
    Style,
    draw_curve,
    drawing,
    episode_means,
    midpoints,
    running_emcc,
    styles,
)
from agents.results.groups import Group
from agents.results.measures import measures as registered
from agents.results.names import by_task, with_names
from agents.results.reading import LeftOut, read_groups
from agents.results.statistics import INTERVALS, common_limit
from agents.training.files import check_file, write_whole
from emcc.parts import ALPHA
from emcc.statistics import FEWEST_RUNS

SUFFIXES = (".pdf", ".svg", ".png", ".pgf")
"""Allowed file formats; .pgf, drawing commands for LaTeX, needs xelatex."""
ASPECT = 0.78
"""Height of a panel, as a share of its width."""


class Plotted(NamedTuple):
    """A measure along training, and the label of its column of panels."""

    label: str
    of: Callable[[Group], Curve]


MEASURES = {
    "return": Plotted("return", lambda group: episode_means(group, "reward")),
    "cost": Plotted("cost", lambda group: episode_means(group, "cost")),
    "emcc": Plotted("EMCC", running_emcc),
    "length": Plotted("steps of an episode", lambda group: episode_means(group, "length")),
}
"""Measures that can be drawn along training."""


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
    if out.suffix.lower() not in SUFFIXES:
        raise UserError(f"out must end in {', '.join(SUFFIXES)}, got {str(out)!r}")
    check_file(out)
    if unknown := [name for name in measures if name not in MEASURES]:
        words = f"measure {unknown[0]!r} cannot be drawn: {nearest(unknown[0], MEASURES)}"
        if unknown[0] in [m.name for m in registered()]:
            words += "; it is a number of a whole run: see the report's figure of every run"
        raise UserError(words)
    if not measures:
        raise UserError(f"plot needs a measure: {', '.join(MEASURES)}")
    notes: list[str] = []
    tasks = by_task(with_names(read_groups(paths, notes)))
    left_out = [note for note in notes if isinstance(note, LeftOut)]
    if not tasks:
        raise UserError("; ".join(["no run is complete", *left_out]))
    entries = list(dict.fromkeys(group.name for own in tasks.values() for group in own))
    shown = _given("names", names, entries)
    colour = _given("colours", colours, entries)
    _draw(tasks, out, [MEASURES[name] for name in measures], shown, colour, width)
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


def _draw(
    tasks: Mapping[str, Sequence[Group]],
    out: Path,
    columns: Sequence[Plotted],
    names: Mapping[str, str],
    colours: Mapping[str, str],
    width: float,
) -> None:
    from matplotlib.colors import is_color_like
    from matplotlib.ticker import EngFormatter

    if wrong := [colour for colour in colours.values() if not is_color_like(colour)]:
        raise UserError(f"colours: {wrong[0]!r} is no colour of matplotlib, such as #0072B2 or C0")
    entries = [group.name for groups in tasks.values() for group in groups]
    shown = {*(names.get(entry, entry) for entry in entries), "cost limit"}
    fitting = max(1, min(len(shown), int(14 * width) // (max(map(len, shown)) + 7)))
    below = 0.16 * math.ceil(len(shown) / fitting)
    height = len(tasks) * ASPECT * width / len(columns) + below + 0.4
    with drawing(8) as pyplot:
        # Text stays text in both formats; journals refuse type 3, matplotlib's default in PDF.
        pyplot.rcParams.update({"pdf.fonttype": 42, "svg.fonttype": "none", "axes.linewidth": 0.6})
        figure, axes = pyplot.subplots(
            len(tasks),
            len(columns),
            figsize=(width, height),
            layout="constrained",
            squeeze=False,
            sharex="row",
        )
        handles: dict[str, Any] = {}
        for row, (task, groups) in zip(axes, tasks.items(), strict=True):
            looks = styles([group.config for group in groups])
            limit = common_limit(groups)
            for axis, column in zip(row, columns, strict=True):
                for group, look in zip(groups, looks, strict=True):
                    entry = group.name
                    own = Style(colours.get(entry, look.colour), look.dash, look.marker)
                    name = names.get(entry, entry)
                    at = midpoints(group.total_steps)
                    draw_curve(axis, name, own, at, column.of(group))
                    handles.setdefault(name, axis.lines[-1])
                if column.label == "cost" and limit is not None:
                    line = axis.axhline(limit, color="#666666", linewidth=0.8, linestyle=":")
                    handles["cost limit"] = line
                if column.label == "EMCC":
                    axis.set_ylim(0, 1)
                axis.set_xlim(0, max(group.total_steps for group in groups))
                axis.xaxis.set_major_formatter(EngFormatter(sep=""))
                axis.spines[["top", "right"]].set_visible(False)
            row[0].set_ylabel(task.removeprefix("circle2d_mj/"))
        for axis, column in zip(axes[0], columns, strict=True):
            axis.set_title(column.label, fontsize=8)
        for axis in axes[-1]:
            axis.set_xlabel("environment steps")
        figure.legend(handles.values(), handles, ncols=fitting, **BELOW)
        _save(figure, out)
        pyplot.close(figure)


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
