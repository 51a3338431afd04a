"""The tidy frame of runs, and means over them, against numbers worked out here."""

from dataclasses import replace
from statistics import fmean, stdev

import numpy as np
import pytest
import scipy.stats
from small_runs import write_evaluated

from agents.paper.presets import preset
from agents.results.frame import COLUMNS, frame
from agents.results.measures import measures
from agents.results.reading import read
from agents.results.statistics import group_mean


@pytest.fixture
def groups(tmp_path):
    """CPO's seeds 0 to 2 and, in another folder, 3 and 4; WCSAC; on another level."""
    write_evaluated(tmp_path / "a", "cpo", costs=(1, 2, 3))
    write_evaluated(tmp_path / "b", "cpo", costs=(4, 5), seeds=(3, 4))
    write_evaluated(tmp_path / "c", "wcsac", costs=(5, 6))
    write_evaluated(tmp_path / "d", "cpo", costs=(7,), task="Circle2D-2-v0")
    return read([tmp_path], [])


def test_a_row_for_each_run_and_measure(groups):
    tidy = frame(groups)
    assert list(tidy.columns) == list(COLUMNS)
    assert len(tidy) == (5 + 2 + 1) * len(measures())
    assert [group.folder for group in groups] == ["a + b", "c", "d"]
    for number, group in enumerate(groups):
        for run in group.runs:
            rows = tidy[(tidy["group"] == number) & (tidy["seed"] == run.seed)]
            assert set(rows["task"]) == {group.task}
            assert set(rows["settings"]) == {"100 steps"}
            for row in rows.itertuples():
                name = row.measure if np.isnan(row.part) else f"{row.measure}_{row.part}"
                value = run.measures[name]
                assert row.value == value or (value is None and np.isnan(row.value))
    assert set(tidy.loc[tidy["measure"] == "EMCC", "part"]) == {0.33, 0.66, 0.99}
    assert tidy.loc[tidy["measure"] != "EMCC", "part"].isna().all()


def test_a_users_pivot(groups):
    """EMCC by algorithm and third, in one line."""
    tidy = frame(groups)
    cells = tidy[tidy["measure"] == "EMCC"].pivot_table("value", ["task", "algorithm"], "part")
    assert cells.loc[("Circle2D-1-v0", "cpo"), 0.66] == pytest.approx(0.3)
    assert cells.loc[("Circle2D-2-v0", "cpo"), 0.33] == pytest.approx(0.7)


def test_means_and_their_intervals(groups):
    """Five runs have the t interval, two their range."""
    cpo, wcsac, single = (group_mean(group, "cost_rate") for group in groups)
    values = [0.1, 0.2, 0.3, 0.4, 0.5]
    half = scipy.stats.t.ppf(0.975, 4) * stdev(values) / 5**0.5
    expected = (fmean(values), fmean(values) - half, fmean(values) + half)
    assert (cpo.value, cpo.low, cpo.high) == pytest.approx(expected)
    assert (wcsac.low, wcsac.high) == (0.5, 0.6)
    assert single.low is None
    assert group_mean(replace(groups[0], runs=[]), "cost_rate") is None
    assert preset("cpo", "Circle2D-1-v0") == groups[0].config.hyperparameters
