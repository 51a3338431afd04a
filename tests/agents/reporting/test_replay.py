"""The data of the replay, read back here, against the files of the runs."""

import base64
import json
from types import SimpleNamespace

import numpy as np
import pytest
from small_runs import STREAKS, chain, edit_results, evaluate, groups_of, write_runs

from agents.reporting import maps
from agents.reporting.maps import Scenes, replay_data
from agents.reporting.page import script_json


@pytest.fixture
def runs(tmp_path):
    """Two runs of 24 episodes of 5 steps, each with a chain of cost steps at its beginning."""
    write_runs(tmp_path / "a")
    evaluate(tmp_path / "a")
    streaks = [streak for pair in STREAKS for streak in pair]
    costs = np.concatenate([chain(k, 5) for k in streaks])
    return SimpleNamespace(folder=tmp_path, streaks=streaks, costs=costs)


def bits(text):
    return np.unpackbits(np.frombuffer(base64.b64decode(text), np.uint8))


def test_every_number(runs):
    notes = []
    data = replay_data(groups_of(runs.folder / "a"), Scenes(), notes)
    assert notes == []
    assert (data["windows"], data["extents"]) == (60, [[-15.0, 15.0, -15.0, 15.0]])
    assert [run["seed"] for run in data["runs"]] == [0, 1]
    for seed, run in enumerate(data["runs"]):
        assert (run["task"], run["algorithm"]) == ("Circle2D-3-v0", "SAC-Lag (120 steps)")
        # Windows of two steps: an episode each, in those where one starts.
        assert run["start"] == [5 * k for k in range(24)]
        assert run["window"] == [5 * k // 2 for k in range(24)]
        assert (run["length"], run["cost"]) == (5, None)
        np.testing.assert_array_equal(bits(run["unsafe"])[:120], runs.costs)
        visited = np.arange(240).reshape(120, 2) / 100 + seed
        weights = 2 ** np.arange(9, -1, -1)
        points = bits(run["points"])[: 120 * 20].reshape(120, 2, 10) @ weights
        low, high = np.reshape(run["box"], (2, 2))
        off = np.abs(low + points * (high - low) / 1023 - visited)
        assert (off <= 0.51 * (high - low) / 1023).all()
    # The middle of 50 points lies at 61.2 of 120 steps: rollouts that start in [55.2, 67.2].
    assert data["runs"][0]["emcc"][25] == round(1000 * max(runs.streaks[12:14]) / 5)


def test_costs_and_lengths_that_differ(runs):
    """Costs other than 0 and 1 are summed, and lengths told one by one, where they must be."""
    folder, lengths = runs.folder / "b", [5] * 22 + [10]
    write_runs(folder, weight=2.5, lengths=lengths, each=1)
    evaluate(folder)
    _, run = replay_data(groups_of(folder), Scenes(), [])["runs"]
    assert run["length"] == lengths
    assert run["cost"] == [2.5 * k for k in runs.streaks[:22]] + [2.5 * sum(runs.streaks[22:])]


def test_runs_that_cannot_be_replayed(runs):
    edit_results(runs.folder / "a", **{"Circle2D-3-v0__1__replay__points": None})
    notes = []
    data = replay_data(groups_of(runs.folder / "a"), Scenes(), notes)
    assert [run["seed"] for run in data["runs"]] == [0]
    assert notes == ["no replay of a: it has no positions"]


def test_of_many_runs_the_first_seeds(runs, monkeypatch):
    monkeypatch.setattr(maps, "REPLAYED", 1)
    notes = []
    data = replay_data(groups_of(runs.folder / "a") * 2, Scenes(), notes)
    assert [run["seed"] for run in data["runs"]] == [0, 0]
    assert notes == ["seeds of each algorithm in the replay: 1"]


def test_names_cannot_end_the_script():
    assert json.loads(script_json({"a": "</script><b>"})) == {"a": "</script><b>"}
    assert "<" not in script_json({"a": "</script><b>"})
