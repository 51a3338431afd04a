"""Measures of a stretch of training: EMCC, and the numbers that other papers report."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from emcc.arrays import as_number, check_records
from emcc.parts import cost_rate
from emcc.records import EpisodeRecords
from emcc.tail import cvar, emcc

LEVELS = (0.25, 0.5, 0.75)
"""Values tau of the MCC for which a panel has P(MCC > tau)."""


@dataclass(frozen=True)
class CostMeasures:
    """Measures of the costs C of episodes: C_i of N episodes, limit d, in the order of training.

    The four that need a limit are None without one.
    """

    episodes: int
    steps: int
    cost_rate: float
    """All costs / all steps. Source: Safety Gym (Ray et al. 2019)."""
    cvar: float
    """CVaR of C: the mean of the share alpha of highest C. Source: WCSAC (Yang et al. 2021)."""
    violation_rate: float | None
    """V, the share of episodes with C > d. Source: SafeRLEval (2026), with both severities."""
    severity: float | None
    """D, the mean of (C - d) / d over all episodes; None where d is 0."""
    severity_of_violations: float | None
    """D+, the same over violating episodes: 0 where none violates, else None where d is 0."""
    regret: float | None
    """Sum of max(C - d, 0). Source: C-TRPO and the literature on constrained bandits."""
    p95: float
    """95th percentile of C, between neighbours by linear interpolation."""
    maximum: float
    """Highest C."""
    peak_rate: float
    """Highest cost rate of a window of consecutive episodes: all costs / all steps of it. A stretch
    with fewer episodes is one window."""


@dataclass(frozen=True)
class Measures(CostMeasures):
    """All measures of a stretch of training, or of the episodes of a final policy."""

    emcc: float
    """EMCC of the rollouts, with risk level alpha: see `emcc.emcc`."""
    mcc: float
    """The mean of MCC over all rollouts: EMCC with alpha = 1."""
    mcc_above: dict[float, float]
    """P(MCC > tau), the share of rollouts, for the tau of `LEVELS`."""
    longest_streak: int
    """Of all trajectories, in steps."""
    mean_streak: float | None
    """`EpisodeRecords.mean_streak`."""


def measures_of(
    records: EpisodeRecords,
    episodes: EpisodeRecords,
    limit: float | None,
    alpha: float,
    window: int,
    ties: str,
) -> Measures:
    """All measures of a stretch of training; the arguments are those of `panel`, checked."""
    mcc, _ = records.mcc_per_rollout()
    in_order = np.argsort(episodes.start_step, kind="stable")
    costs = cost_measures(
        episodes.cost[in_order], episodes.length[in_order], limit, alpha, window, ties
    )  # fmt: skip
    # Rollouts may also hold pieces of episodes that have not ended.
    rate = cost_rate(records.cost, records.length)
    return Measures(
        **{**vars(costs), "cost_rate": rate, "steps": records.total_steps},
        emcc=emcc(mcc, alpha, ties),
        mcc=emcc(mcc),
        mcc_above={level: float((mcc > level).mean()) for level in LEVELS},
        longest_streak=int(records.longest_streak.max()),
        mean_streak=records.mean_streak,
    )


def cost_measures(
    cost: NDArray, length: NDArray, limit: float | None, alpha: float, window: int, ties: str
) -> CostMeasures:
    """Measures of episode costs [N] and lengths [N] in steps, in the order of training."""
    windows = min(window, len(cost))
    rates = _windows(cost, windows).sum(-1) / _windows(length, windows).sum(-1)
    over = None if limit is None else cost - limit
    of_limit = dict.fromkeys(("violation_rate", "severity", "severity_of_violations", "regret"))
    if over is not None and limit is not None:
        violating = over[over > 0]
        of_violations = float(violating.mean() / limit) if limit and violating.size else None
        of_limit = {
            "violation_rate": float((over > 0).mean()),
            "severity": float(over.mean() / limit) if limit else None,
            "severity_of_violations": of_violations if violating.size else 0.0,
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
        **of_limit,
    )


def _windows(values: NDArray, window: int) -> NDArray:
    """[N - window + 1, window]: all runs of consecutive values."""
    return np.lib.stride_tricks.sliding_window_view(values, window)


def feasible(
    episodes: EpisodeRecords, limit: float, window: int
) -> tuple[int | None, float | None]:
    """Steps to the first window within the limit, and the share of windows from there that are."""
    order = np.argsort(episodes.start_step, kind="stable")
    within = _windows(episodes.cost[order], window).mean(-1) <= limit
    if not within.any():
        return None, 0.0
    first = int(np.argmax(within))
    return int(episodes.start_step[order][first]), float(within[first:].mean())


def regret_curve(
    records: EpisodeRecords, limit: float
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Cost regret over training: steps [E] at which episodes start, and the regret so far [E].

    limit: d, as in `panel`; the regret so far is the sum of max(C - d, 0) of the episodes that
    started up to then. Errors as in `panel`.
    """
    if (limit := as_number(limit, "limit")) < 0:
        raise ValueError(f"limit must be >= 0, got {limit}")
    check_records(records)
    order = np.argsort(records.start_step, kind="stable")
    return records.start_step[order], np.maximum(records.cost[order] - limit, 0).cumsum()
