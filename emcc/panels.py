"""EMCC beside the numbers that papers on safe exploration report, from one set of costs."""

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

from emcc.arrays import as_count, as_number, check_records
from emcc.measures import LEVELS, Measures, feasible, measures_of
from emcc.parts import ALPHA, PARTS
from emcc.records import EpisodeRecords
from emcc.statistics import COST, SHARE, Bounds
from emcc.table import Table, intervals, mean_cell

WINDOW = 100
"""Episodes of a moving window."""
SEVERITY: Bounds = (-1.0, math.inf)
"""An episode without cost is 100 % below the limit."""
SOURCES = {
    "training": "costs during training",
    "stochastic": "costs of the final policy, with its noise",
    "deterministic": "costs of the final policy, without noise",
}
"""Where costs come from, in words."""


@dataclass(frozen=True)
class Panel(Measures):
    """Measures of a whole training, and of its thirds."""

    steps_to_feasible: int | None
    """Environment steps before the first window of episodes whose mean C is within d; None where
    no window is. Source: the zero-violation study (PRICAI 2026), with the share below."""
    feasible_share: float | None
    """Share of the windows from that one on whose mean C is within d; 0 where no window is."""
    parts: dict[float, Measures | None]
    """Of each third of training, by its beta; None where no rollout starts in it. Empty for a final
    policy."""
    limit: float | None
    alpha: float
    ties: str
    """Reading of alpha: see `emcc.emcc`."""
    window: int
    """Episodes of a moving window: at most those there are."""
    source: str
    """One of `SOURCES`."""

    def to_dict(self) -> dict[str, Any]:
        """All numbers by name, the thirds in "parts"; json can write it."""

        def plain(value: Any) -> Any:
            if isinstance(value, dict):
                return {str(key): plain(entry) for key, entry in value.items()}
            return value

        return plain(asdict(self))

    def to_markdown(self) -> str:
        """A table: a row for each measure, a column for all of training and for each third."""
        return panel_table([self]).render("md")

    def to_latex(self) -> str:
        """The same table for LaTeX, with the rules of the package booktabs."""
        return panel_table([self]).render("latex")


def panel(
    records: EpisodeRecords,
    limit: float | None = None,
    alpha: float = ALPHA,
    *,
    ties: str = "all",
    window: int = WINDOW,
    total_steps: int | None = None,
    episodes: EpisodeRecords | None = None,
    source: str = "training",
) -> Panel:
    """EMCC and the measures it is compared with.

    limit: d of an episode's undiscounted cost, >= 0; None leaves out the measures that need one.
    alpha, ties: of EMCC and of CVaR, as in `emcc.emcc`. window: episodes of a moving window; all,
    where there are fewer. total_steps: environment steps of the whole training, by default those
    recorded. episodes: records whose rows are whole episodes, for the measures of episode costs,
    where rollouts cut those of `records`. source: one of `SOURCES`; only training has thirds and a
    time to feasible. Episodes are taken by rising start step.
    TypeError: something else than records. ValueError: no trajectory, or an argument that is not
    allowed.
    """
    if limit is not None and (limit := as_number(limit, "limit")) < 0:
        raise ValueError(f"limit must be >= 0, got {limit}")
    if source not in SOURCES:
        raise ValueError(f"source must be one of {', '.join(SOURCES)}, got {source!r}")
    episodes = records if episodes is None else episodes
    for name, given in (("records", records), ("episodes", episodes)):
        check_records(given, name)
    window = min(as_count(window, "window"), len(episodes))
    whole = measures_of(records, episodes, limit, alpha, window, ties)
    parts: dict[float, Measures | None] = {}
    from_then = None, None
    if source == "training":
        if total_steps is None:
            total_steps = max(records.total_steps, episodes.total_steps)
        of_records, of_episodes = (of.by_part(total_steps) for of in (records, episodes))
        for part in PARTS:
            some = len(of_records[part]) and len(of_episodes[part])
            given = of_records[part], of_episodes[part]
            parts[part] = measures_of(*given, limit, alpha, window, ties) if some else None
        if limit is not None:
            from_then = feasible(episodes, limit, window)
    return Panel(**vars(whole), steps_to_feasible=from_then[0], feasible_share=from_then[1],
        parts=parts, limit=limit, alpha=alpha, ties=ties, window=window, source=source)  # fmt: skip


class Row(NamedTuple):
    """A measure in a table: its title, its value in one stretch of training, decimal places, and
    the values that there can be."""

    title: str
    value: Callable[[Measures], float | None]
    digits: int = 3
    bounds: Bounds = COST


def rows(of: Panel) -> list[Row]:
    """The rows of a panel's table; those that need a limit only where there is one."""
    windows = f"{of.window} episodes"
    share = f"α = {of.alpha:g}" + (f", ties {of.ties}" if of.ties != "all" else "")
    listed = [
        Row(f"EMCC ({share})", lambda m: m.emcc, bounds=SHARE),
        Row("mean MCC", lambda m: m.mcc, bounds=SHARE),
        *(
            Row(f"P(MCC > {level:g})", lambda m, k=level: m.mcc_above[k], bounds=SHARE)
            for level in LEVELS
        ),
        Row("longest streak (steps)", lambda m: m.longest_streak, 0),
        Row("mean streak (steps)", lambda m: m.mean_streak, 2),
        Row("cost rate (per step)", lambda m: m.cost_rate),
        Row(f"peak cost rate ({windows})", lambda m: m.peak_rate),
        Row(f"CVaR of episode cost ({share})", lambda m: m.cvar, 2),
        Row("95th percentile of episode cost", lambda m: m.p95, 2),
        Row("highest episode cost", lambda m: m.maximum, 2),
    ]
    if of.limit is not None:
        listed += [
            Row("violation rate V", lambda m: m.violation_rate, bounds=SHARE),
            Row("severity D", lambda m: m.severity, bounds=SEVERITY),
            Row("severity of violations D+", lambda m: m.severity_of_violations),
            Row("cost regret", lambda m: m.regret, 1),
            Row(f"steps until {windows} are within the limit", _of_whole("steps_to_feasible"), 0),
            Row(
                "share of training within it from then on",
                _of_whole("feasible_share"),
                bounds=SHARE,
            ),
        ]
    return listed


def _of_whole(name: str) -> Callable[[Measures], float | None]:
    """A measure that thirds of training do not have."""
    return lambda stretch: getattr(stretch, name, None)


def panel_table(
    panels: Sequence[Panel], name: str = "", notes: Sequence[str] = (), seed: int = 0
) -> Table:
    """The table of the means over runs of one kind, with their intervals.

    name: of the runs, for the caption; seed: of the bootstrap. A cell is empty where any run has no
    such value.
    """
    first = panels[0]
    of_runs: list[list[Measures | None]] = [list(panels)]
    of_runs += [[of.parts[part] for of in panels] for part in first.parts]
    cells = []
    for row in rows(first):
        values = [[None if m is None else row.value(m) for m in stretch] for stretch in of_runs]
        means = (mean_cell(of_row, row.digits, seed, row.bounds) for of_row in values)
        cells.append([row.title, *means])
    limit = "no limit" if first.limit is None else f"limit {first.limit:g}"
    sizes = " and ".join(
        dict.fromkeys(f"{of.episodes} episodes, {of.steps} steps" for of in panels)
    )
    if len(panels) > 1:
        sizes = f"means over {len(panels)} runs {intervals()}"
    head = ["all" if first.parts else "value", *(PARTS[part] for part in first.parts)]
    return Table(
        f"{name + ': ' if name else ''}{SOURCES[first.source]}, {limit}; {sizes}",
        ["measure", *head],
        cells,
        list(notes),
        complete=all(m is not None for stretch in of_runs for m in stretch),
    )
