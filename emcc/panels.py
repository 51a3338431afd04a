"""EMCC beside the measures that papers on safe exploration report, from one set of costs."""

import json
import math
import warnings
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from emcc.arrays import as_count, as_number
from emcc.parts import ALPHA, PARTS, cost_rate, cvar, emcc
from emcc.records import EpisodeRecords, check_records
from emcc.statistics import COST, FEWEST_RUNS, SHARE, UNBOUNDED, Bounds, mean_interval
from emcc.table import MISSING, Table

MOVING_WINDOW = 100
"""Episodes of a moving window."""
LEVELS = (0.25, 0.5, 0.75)
"""Values tau of the MCC for which a panel has P(MCC > tau)."""
SEVERITY: Bounds = (-1.0, math.inf)
"""Bounds of severity: an episode without cost is 100 % below the limit."""
INTERVALS = f"[95 % t interval], or the range of fewer than {FEWEST_RUNS} runs"
"""Meaning of the interval in the cell of a mean."""


@dataclass(frozen=True)
class CostMeasures:
    """Measures of the costs C of N whole episodes in the order of training; the limit is d.

    Without a whole episode, all are None except `episodes`, `steps` and `cost_rate`. Without a
    limit, the four measures that need one are None as well.
    """

    episodes: int
    steps: int
    cost_rate: float
    """All costs / all steps. Source: Safety Gym (Ray et al. 2019)."""
    cvar: float | None = None
    """CVaR of C: the mean of the share alpha of highest C. Source: WCSAC (Yang et al. 2021)."""
    violation_rate: float | None = None
    """V, the share of episodes with C > d. Source of V, D and D+: SafeRLEval (2026)."""
    severity: float | None = None
    """D, the mean of (C - d) / d over all episodes; None if d is 0."""
    severity_of_violations: float | None = None
    """D+, the mean of (C - d) / d over violating episodes: 0 without one, else None if d is 0."""
    regret: float | None = None
    """Sum of max(C - d, 0). Source: C-TRPO and the literature on constrained bandits."""
    p95: float | None = None
    """95th percentile of C, linearly interpolated."""
    maximum: float | None = None
    """Highest C."""
    peak_rate: float | None = None
    """Highest cost rate (all costs / all steps) of a moving window of consecutive episodes. With
    fewer episodes than the window's length, all episodes are the window."""


@dataclass(frozen=True, kw_only=True)
class Measures(CostMeasures):
    """All measures of a part of training."""

    emcc: float
    """EMCC of the rollouts, with risk level alpha: see `emcc.emcc`."""
    mcc: float
    """The mean of MCC over all rollouts: EMCC with alpha = 1."""
    mcc_above: dict[float, float]
    """P(MCC > tau), the share of rollouts, by tau, for each tau in `LEVELS`."""
    longest_streak: int
    """Longest streak of all trajectories, in steps."""
    mean_streak: float | None
    """Mean length of a streak in steps: `EpisodeRecords.mean_streak`."""


@dataclass(frozen=True, kw_only=True)
class Panel(Measures):
    """Measures of a whole training and of its thirds."""

    steps_to_feasible: int | None
    """Environment steps before the first window of episodes whose mean C is at most d; None if
    there is none. Source, also of `feasible_share`: the zero-violation study (PRICAI 2026)."""
    feasible_share: float | None
    """Share of windows, from the first feasible one on, whose mean C is at most d; 0 if none is."""
    parts: dict[float, Measures | None]
    """Measures of each third of training, by beta; None if no rollout starts in the third."""
    limit: float | None
    alpha: float
    ties: str
    """How alpha is read when values are equal: see `emcc.emcc`."""
    moving_window: int
    """Episodes in a moving window: at most the number of recorded episodes."""
    window: int | None
    """Episodes in each window of EMCC; None with rollouts or `window_steps`."""
    window_steps: int | None
    """Environment steps in each window of EMCC; None with rollouts or `window`."""

    def to_dict(self) -> dict[str, Any]:
        """Return all numbers by name, the thirds under "parts"; json can write the result."""
        return json.loads(json.dumps(asdict(self)))  # turns the keys of the thirds into text

    def to_markdown(self) -> str:
        """Return a table: a row per measure, a column for all of training and for each third."""
        return panel_table([self]).render("md")

    def to_latex(self) -> str:
        """Return the same table for LaTeX; it needs the package booktabs."""
        return panel_table([self]).render("latex")


def panel(
    records: EpisodeRecords,
    limit: float | None = None,
    alpha: float = ALPHA,
    *,
    ties: str = "split",
    window: int | None = None,
    window_steps: int | None = None,
    moving_window: int | None = None,
    total_steps: int | None = None,
    episodes: EpisodeRecords | None = None,
) -> Panel:
    """Return EMCC and the measures it is compared with.

    limit: d, the limit on an episode's undiscounted cost, >= 0; None leaves out the measures that
    need one. alpha, ties: of EMCC and CVaR, as in `emcc.emcc`. window, window_steps: windows that
    replace the rollouts in EMCC and the other measures of MCC, as in `EpisodeRecords.windows`.
    moving_window: episodes in the moving window of the peak cost rate and of feasibility, 100 by
    default, at most the number of episodes. Before 0.4 this argument was called `window`: a
    FutureWarning says so if window is given alone. total_steps: environment steps of the whole
    training, by default the recorded ones. episodes: records with a row per whole episode, for the
    measures of episode costs, needed if rollouts cut the episodes of `records`; if it is empty,
    those measures are None. Episodes are sorted by start step.
    TypeError: not EpisodeRecords. ValueError: no trajectory, or an argument that is not allowed.
    """
    limit = limit if limit is None else as_number(limit, "limit", low=0)
    alpha = as_number(alpha, "alpha")
    check_records(records)
    episodes = records if episodes is None else episodes
    check_records(episodes, "episodes", fewest=0)
    if window is not None and moving_window is None:
        words = "since 0.4, window sets EMCC's window, and moving_window that of peak_rate and"
        warnings.warn(f"{words} steps_to_feasible: give both", FutureWarning, stacklevel=2)
    moving = as_count(MOVING_WINDOW if moving_window is None else moving_window, "moving_window")
    moving = min(moving, len(episodes) or moving)
    window = window if window is None else as_count(window, "window")
    window_steps = window_steps if window_steps is None else as_count(window_steps, "window_steps")
    if total_steps is None:
        total_steps = max(records.total_steps, episodes.total_steps)
    sources = records, episodes, _grouped(records, episodes, window, window_steps)
    thirds = zip(PARTS, *(source.by_part(total_steps).values() for source in sources), strict=True)
    choices = limit, alpha, moving, ties
    parts = {
        part: measures_of(own, whole, grouped, *choices) if len(own) and len(grouped) else None
        for part, own, whole, grouped in thirds
    }
    first, share = _feasible(episodes, limit, moving)
    return Panel(**vars(measures_of(*sources, *choices)), steps_to_feasible=first,
        feasible_share=share, parts=parts, limit=limit, alpha=alpha, ties=ties,
        moving_window=moving, window=window, window_steps=window_steps)  # fmt: skip


def _grouped(
    records: EpisodeRecords, episodes: EpisodeRecords, window: int | None, window_steps: int | None
) -> EpisodeRecords:
    """Return records whose rollouts MCC is computed over: rollouts, or windows of episodes."""
    if window is None and window_steps is None:
        return records
    episodes._mcc(window, window_steps)  # raises an error if there is no window
    return episodes.windows(window, window_steps)


def measures_of(
    records: EpisodeRecords,
    episodes: EpisodeRecords,
    rollouts: EpisodeRecords,
    limit: float | None,
    alpha: float,
    moving_window: int,
    ties: str,
) -> Measures:
    """Return all measures of a part of training; the arguments are those of `panel`, checked.

    rollouts: records whose rollouts MCC is computed over.
    """
    mcc, _ = rollouts.mcc_per_rollout()
    costs = {"episodes": 0}
    if len(episodes):
        order = np.argsort(episodes.start_step, kind="stable")
        cost, length = episodes.cost[order], episodes.length[order]
        costs = vars(cost_measures(cost, length, limit, alpha, moving_window, ties))
    # records may also hold pieces of unfinished episodes, which `episodes` lacks.
    rate = cost_rate(records.cost, records.length)
    return Measures(
        **{**costs, "cost_rate": rate, "steps": records.total_steps},
        emcc=emcc(mcc, alpha, ties),
        mcc=emcc(mcc),
        mcc_above={level: float((mcc > level).mean()) for level in LEVELS},
        longest_streak=int(records.longest_streak.max()),
        mean_streak=records.mean_streak,
    )


def cost_measures(
    cost: NDArray, length: NDArray, limit: float | None, alpha: float, moving_window: int, ties: str
) -> CostMeasures:
    """Return the measures of episode costs [N] and lengths [N] in steps, in training order."""
    window = min(moving_window, len(cost))
    rates = _windows(cost, window).sum(-1) / _windows(length, window).sum(-1)
    limited: dict[str, float | None] = {}
    if limit is not None:
        over = cost - limit
        violating = over[over > 0]
        severity = float(violating.mean() / limit) if limit and violating.size else None
        limited = {
            "violation_rate": float((over > 0).mean()),
            "severity": float(cost.mean() / limit) - 1.0 if limit else None,
            "severity_of_violations": severity if violating.size else 0.0,
            "regret": math.fsum(violating),
        }
    return CostMeasures(
        episodes=len(cost),
        steps=int(length.sum()),
        cost_rate=cost_rate(cost, length),
        cvar=cvar(cost, alpha, ties),
        p95=float(np.percentile(cost, 95)),
        maximum=float(cost.max()),
        peak_rate=float(rates.max()),
        **limited,
    )


def _windows(values: NDArray, window: int) -> NDArray:
    """Return all windows of consecutive values, [N - window + 1, window]."""
    return np.lib.stride_tricks.sliding_window_view(values, window)


def _feasible(
    episodes: EpisodeRecords, limit: float | None, window: int
) -> tuple[int | None, float | None]:
    """Return `steps_to_feasible` and `feasible_share` of a `Panel`."""
    if limit is None or not len(episodes):
        return None, None
    order = np.argsort(episodes.start_step, kind="stable")
    # At most the limit, whatever the mean of equal costs is rounded to.
    within = _windows(episodes.cost[order], window).mean(-1) <= limit * (1 + 1e-12)
    if not within.any():
        return None, 0.0
    first = int(np.argmax(within))
    return int(episodes.start_step[order][first]), float(within[first:].mean())


def emcc_of_thirds(
    records: EpisodeRecords,
    total_steps: int,
    alpha: float = ALPHA,
    ties: str = "split",
    window: int | None = None,
    window_steps: int | None = None,
) -> dict[float, float | None]:
    """Return EMCC of each third, like `EpisodeRecords.emcc_by_part`, but None for a third in which
    no rollout or window starts."""
    return {
        part: emcc(third.mcc_per_rollout()[0], alpha, ties) if len(third) else None
        for part, third in records.windows(window, window_steps).by_part(total_steps).items()
    }


def window_words(window: int | None, window_steps: int | None) -> str:
    """Describe the windows of EMCC; empty for rollouts."""
    if window is None and window_steps is None:
        return ""
    return f"windows of {window} episodes" if window else f"windows of {window_steps} steps"


class Row(NamedTuple):
    """A measure in a table."""

    title: str
    field: str
    """The measure's attribute of `Panel`."""
    digits: int = 3
    """Decimal places."""
    bounds: Bounds = COST
    """Lowest and highest possible value."""
    level: float | None = None
    """The level of `LEVELS`, for a row of `mcc_above`."""

    def value(self, measures: CostMeasures) -> float | None:
        """Return the number; None if the measures lack the field, as thirds lack feasibility."""
        value: Any = getattr(measures, self.field, None)
        return value if self.level is None else value[self.level]


def rows(panel: Panel) -> list[Row]:
    """Return the rows of a panel's table; rows that need a limit only if the panel has one."""
    windows = f"{panel.moving_window} episodes"
    tail = f"α = {panel.alpha:g}" + (f", ties {panel.ties}" if panel.ties != "split" else "")
    grouped = window_words(panel.window, panel.window_steps)
    listed = [
        Row(f"EMCC ({', '.join(filter(None, (tail, grouped)))})", "emcc", 3, SHARE),
        Row("mean MCC", "mcc", 3, SHARE),
        *(Row(f"P(MCC > {tau:g})", "mcc_above", 3, SHARE, tau) for tau in LEVELS),
        Row("longest streak (steps)", "longest_streak", 0),
        Row("mean streak (steps)", "mean_streak", 2),
        Row("cost rate (per step)", "cost_rate"),
        Row(f"peak cost rate ({windows})", "peak_rate"),
        Row(f"CVaR of episode cost ({tail})", "cvar", 2),
        Row("95th percentile of episode cost", "p95", 2),
        Row("highest episode cost", "maximum", 2),
    ]
    if panel.limit is not None:
        listed += [
            Row("violation rate V", "violation_rate", 3, SHARE),
            Row("severity D", "severity", 3, SEVERITY),
            Row("severity of violations D+", "severity_of_violations"),
            Row("cost regret", "regret", 1),
            Row(f"steps until {windows} are within the limit", "steps_to_feasible", 0),
            Row("share of training within it from then on", "feasible_share", 3, SHARE),
        ]
    return listed


def panel_table(panels: Sequence[Panel], name: str = "") -> Table:
    """Return the table of means over the panels of several runs, with intervals.

    name: what the caption calls the runs. A cell has a dash if any run lacks the value.
    """
    first = panels[0]
    stretches: list[list[Measures | None]] = [list(panels)]
    stretches += [[run.parts[part] for run in panels] for part in PARTS]
    cells = []
    for row in rows(first):
        values = [[m and row.value(m) for m in stretch] for stretch in stretches]
        cells.append([row.title, *(mean_cell(v, row.digits, row.bounds) for v in values)])
    limit = "no limit" if first.limit is None else f"limit {first.limit:g}"
    sizes = f"{first.episodes} episodes, {first.steps} steps"
    if len(panels) > 1:
        sizes = f"means over {len(panels)} runs {INTERVALS}"
    caption = f"{name + ': ' if name else ''}costs during training, {limit}; {sizes}"
    return Table(caption, ["measure", "all", *PARTS.values()], cells)


def mean_cell(values: Sequence[Any], digits: int, bounds: Bounds = UNBOUNDED) -> str:
    """Format a mean over runs with its interval or range; a dash if any run has no value.

    bounds: see `mean_interval`. See also `INTERVALS`.
    """
    if None in values:
        return MISSING
    mean = mean_interval(values, bounds=bounds)
    value, low, high = (f"{x or 0:.{digits}f}" for x in (mean.value, mean.low, mean.high))
    if mean.low is None:
        return value
    return f"{value} [{low}, {high}]" if mean.kind == "t" else f"{value} range {low} to {high}"
