"""A task's panel of cost measures: numbers by hand, and the limit and window of its columns."""

import dataclasses

import numpy as np
import pytest

from agents.presets import preset
from agents.reporting.tables import common_limit, panel_table
from agents.results.groups import Group, RunResult
from agents.training.config import TrainConfig
from emcc import EpisodeRecords

TASK = "Circle2D-1-v0"
COSTS = [[1, 1, 0, 0], [0, 1, 0, 1], [0, 0, 0, 0], [1, 1, 1, 1]]
FINAL = {"cost_returns": [4.0, 0.0], "lengths": [4, 4]}


def a_group(algorithm, costs=COSTS, seeds=(0,), evaluation=None, **changes):
    hyperparameters = dataclasses.replace(preset(algorithm, TASK), **changes)
    config = TrainConfig(algorithm, (TASK,), tuple(seeds), sum(map(len, costs)), hyperparameters)
    records = EpisodeRecords.from_costs(np.concatenate(costs), list(map(len, costs)))
    evaluation = {"deterministic": FINAL} if evaluation is None else evaluation
    runs = [RunResult(seed, {}, 2, {}, records, evaluation) for seed in seeds]
    return Group(algorithm, TASK, config, runs, [])


def cells(table):
    return {row.name: [str(cell) for cell in row.numbers] for row in table.rows}


def test_the_numbers_of_a_panel_by_hand():
    found = cells(panel_table([a_group("cpo", cost_limit=2.0)]))
    assert found["training: EMCC (α = 0.1)"] == ["1.000"]
    assert found["training: mean MCC"] == ["0.438"]  # 2, 1, 0 and 4 of 4 steps
    assert found["training: longest streak (steps)"] == ["4"]
    assert found["training: mean streak (steps)"] == ["2.00"]  # streaks of 2, 1, 1 and 4 steps
    assert found["training: cost rate (per step)"] == ["0.500"]
    assert found["training: violation rate V"] == ["0.250"]
    assert found["training: severity D"] == ["0.000"]
    assert found["training: severity of violations D+"] == ["1.000"]
    assert found["training: cost regret"] == ["2.0"]
    assert found["training: steps until 4 episodes are within the limit"] == ["0"]
    assert found["policy without noise: violation rate V"] == ["0.500"]
    assert found["policy without noise: cost rate (per step)"] == ["0.500"]
    assert found["policy without noise: severity D"] == ["0.000"]
    assert found["policy without noise: CVaR of episode cost (α = 0.1)"] == ["4.00"]
    assert not any(name.startswith("policy with its noise") for name in found)


def test_algorithms_are_columns_in_a_fixed_order():
    table = panel_table([a_group("wcsac", seeds=(0, 1)), a_group("cpo")])
    assert [name.split(" (")[0] for name in table.head] == [TASK, "CPO", "WCSAC", ""]
    assert table.columns == 3
    assert cells(table)["training: cost rate (per step)"] == ["0.500", "0.500 range 0.500 to 0.500"]
    assert "limit 5" in table.caption


def test_every_column_has_its_own_limit():
    """An algorithm without a limit has that of the others on the same cost."""
    table = panel_table([a_group("cpo", cost_limit=2.0), a_group("sac-lag", cost_limit=3.0)])
    assert "limit of CPO (cost_limit 2.0, 16 steps) 2, limit of SAC-Lag" in table.caption
    assert cells(table)["training: cost regret"] == ["2.0", "1.0"]
    groups = [a_group("sac"), a_group("cpo", cost_limit=2.0)]
    groups.append(dataclasses.replace(groups[1], cost="cost_2"))
    assert cells(panel_table(groups))["training: cost regret"] == ["2.0", "–", "2.0"]
    assert common_limit(groups) is None  # no line of a limit in curves of different costs
    assert "no limit" in panel_table([a_group("sac")]).caption


@pytest.mark.parametrize("ends", ["corridor", "middle"])
def test_intervals_are_t_or_the_range_where_runs_end_in_different_places(ends):
    """Five runs with the cost rates 0, ¼, ... 1 have the standard deviation √(10/16/4); the
    interval's half-width is 2.776445 times that / √5."""
    group, runs = a_group("cpo", seeds=range(5)), []
    for k, run in enumerate(group.runs):
        records = EpisodeRecords.from_costs(np.arange(4.0) < k, [4])
        runs.append(dataclasses.replace(run, records=records, ends={ends if k else "corridor": 1}))
    half = 2.776445 * np.sqrt(10 / 16 / 4 / 5)
    interval = (
        f"[{0.5 - half:.3f}, {0.5 + half:.3f}]" if ends == "corridor" else "range 0.000 to 1.000"
    )
    table = panel_table([dataclasses.replace(group, runs=runs)])
    assert cells(table)["training: cost rate (per step)"] == [f"0.500 {interval}"]


def test_one_window_for_all_columns():
    table = panel_table([a_group("cpo"), a_group("sac-lag", costs=COSTS[:2])])
    assert "training: peak cost rate (2 episodes)" in cells(table)
    assert cells(table)["training: peak cost rate (2 episodes)"] == ["0.500", "0.500"]
