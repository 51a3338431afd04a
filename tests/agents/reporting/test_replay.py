"""The data of the replay, read back here, against the files of the runs."""

import base64
import json
from types import SimpleNamespace

import numpy as np
import pytest
from small_runs import STREAKS, group_of, write_runs

from agents.reporting.maps import Scenes
from agents.reporting.page import script_json
from agents.reporting.replay import replay_data


@pytest.fixture
def runs(tmp_path):
    """Two runs of 24 episodes of 5 steps, each with its chain of cost steps at its end."""
    config = write_runs(tmp_path / "a")
    streaks = [streak for pair in STREAKS for streak in pair]
    costs = np.concatenate([[0.0] * (5 - k) + [1.0] * k for k in streaks])
    for seed in config.seeds:
        np.save(tmp_path / "a" / f"seed-{seed}" / "costs.npy", costs)
    return SimpleNamespace(
        folder=tmp_path, group=group_of(tmp_path / "a", config), streaks=streaks, costs=costs
    )


def bits(text):
    return np.unpackbits(np.frombuffer(base64.b64decode(text), np.uint8))


def test_every_number(runs):
    notes = []
    data = replay_data([runs.group], Scenes(), notes)
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
        visited = np.load(runs.folder / "a" / f"seed-{seed}" / "visited.npy")
        weights = 2 ** np.arange(9, -1, -1)
        points = bits(run["points"])[: 120 * 20].reshape(120, 2, 10) @ weights
        low, high = np.reshape(run["box"], (2, 2))
        off = np.abs(low + points * (high - low) / 1023 - visited)
        assert (off <= 0.51 * (high - low) / 1023).all()
    # The middle of 50 points lies at 61.2 of 120 steps: rollouts that start in [55.2, 67.2].
    assert data["runs"][0]["emcc"][25] == round(1000 * max(runs.streaks[12:14]) / 5)


def test_costs_and_lengths_that_differ(runs):
    """Costs other than 0 and 1 are summed, and lengths told one by one, where they must be."""
    folder = runs.folder / "a" / "seed-1"
    np.save(folder / "costs.npy", runs.costs * 2.5)
    lines = (folder / "episodes.csv").read_text().splitlines()
    rollout, start, length, *others = lines[-1].split(",")
    merged = ",".join([rollout, str(int(start) - 5), str(int(length) + 5), *others])
    (folder / "episodes.csv").write_text("\n".join([*lines[:-2], merged, ""]))
    data = replay_data([group_of(runs.folder / "a", runs.group.config)], Scenes(), [])
    run = data["runs"][1]
    assert run["length"] == [5] * 22 + [10]
    assert run["cost"] == [2.5 * k for k in runs.streaks[:22]] + [2.5 * sum(runs.streaks[22:])]


def test_runs_that_cannot_be_replayed(runs):
    config = write_runs(runs.folder / "b")
    groups = [group_of(runs.folder / "b", config), runs.group]
    (runs.folder / "a" / "seed-1" / "visited.npy").unlink()
    notes = []
    data = replay_data(groups, Scenes(), notes)
    assert [run["seed"] for run in data["runs"]] == [0]
    name = runs.folder.name
    assert notes == [
        f"no replay of {name}/b: {name}/b/seed-0/costs.npy is missing: the run has no record of "
        "its steps",
        f"no replay of {name}/a: it has no positions",
    ]


def test_names_cannot_end_the_script():
    assert json.loads(script_json({"a": "</script><b>"})) == {"a": "</script><b>"}
    assert "<" not in script_json({"a": "</script><b>"})
