"""The curves in a report's figures, against loops over episodes."""

import math
from dataclasses import replace
from statistics import fmean, stdev

import numpy as np
import pytest
from by_hand import T_OF_4

from agents.presets import preset
from agents.reporting import figures
from agents.reporting.figures import POINTS, WINDOW, midpoints
from agents.results.groups import Group, RunResult
from agents.results.measures import measured
from agents.training.config import TrainConfig
from emcc import EpisodeRecords, emcc
from emcc.parts import ALPHA

TOTAL = 4000


def records(seed):
    """Return records of episodes of 5 to 40 steps, two in each rollout."""
    rng = np.random.default_rng(seed)
    length = rng.integers(5, 41, 200)
    length = length[: np.searchsorted(np.cumsum(length), TOTAL) + 1]
    start = np.cumsum(length) - length
    streak = rng.integers(0, length + 1)
    return EpisodeRecords(
        np.arange(len(length)) // 2, start, length, rng.normal(size=len(length)), streak, streak
    )


RUNS = [records(seed) for seed in range(5)]
TASK = "Circle2D-1-v0"


def group(records, places=("",)):
    """Return a group of CPO's runs, which end at the places in turn."""
    config = TrainConfig("cpo", (TASK,), tuple(range(len(records))), TOTAL, preset("cpo", TASK))
    ends = [{places[k % len(places)]: 1} for k in range(len(records))]
    runs = [RunResult(k, {}, 1, ends[k], of_run) for k, of_run in enumerate(records)]
    runs = [replace(run, measures=measured(run, "")) for run in runs]
    return Group("a", TASK, config, runs, [])


THREE, FIVE = group(RUNS[:3]), group(RUNS)


@pytest.mark.parametrize("column", ["reward", "cost"])
def test_episode_means_by_a_loop(column):
    """Three runs have their range, five the t interval, and five that end in different places
    their range."""
    other_places = group(RUNS, ("here", "there"))
    found = [figures.episode_means(line, column) for line in (THREE, FIVE, other_places)]
    lowest = 0.0 if column == "cost" else -math.inf
    for k in range(POINTS):
        means = []
        low, high = k * TOTAL / POINTS, (k + 1) * TOTAL / POINTS
        for run in RUNS:
            pairs = zip(run.start_step, getattr(run, column), strict=True)
            inside = [value for start, value in pairs if low <= start < high]
            if column == "reward":  # returns are drawn to three digits of the largest, 1.0 to 9.99
                assert 1.0 <= np.abs(run.reward).max() < 9.995
                inside = [round(value, 2) for value in inside]
            means.append(sum(inside) / len(inside) if inside else math.nan)
        half = T_OF_4 * stdev(means) / math.sqrt(5)
        if math.isnan(sum(means)):
            assert math.isnan(found[1].mean[k] + found[1].low[k] + found[1].high[k])
            continue
        expected = (
            (fmean(means[:3]), min(means[:3]), max(means[:3])),
            (fmean(means), max(fmean(means) - half, lowest), fmean(means) + half),
            (fmean(means), min(means), max(means)),
        )
        for curve, numbers in zip(found, expected, strict=True):
            drawn = [of[k] for of in curve]
            assert drawn == pytest.approx(numbers, rel=1e-4, abs=1e-4)
    assert np.isfinite(found[1].mean).sum() > POINTS // 2


def test_running_emcc_by_a_loop():
    curve = figures.running_emcc(THREE)
    for k, middle in enumerate(midpoints(TOTAL)):
        values = []
        for run in RUNS[:3]:
            mcc = {}
            for rollout, start, length, streak in zip(
                run.rollout, run.start_step, run.length, run.longest_streak, strict=True
            ):
                first, share = mcc.get(rollout, (start, 0.0))
                mcc[rollout] = (first, max(share, streak / length))
            near = [v for s, v in mcc.values() if abs(s - middle) <= WINDOW / 2 * TOTAL]
            values.append(emcc(near, ALPHA))
        assert curve.mean[k] == pytest.approx(np.mean(values))
        assert (curve.low[k], curve.high[k]) == (min(values), max(values))


def test_one_run_has_a_line_and_no_area():
    curve = figures.running_emcc(group(RUNS[:1]))
    assert np.isfinite(curve.mean).all()
    assert np.isnan(curve.low).all()
