"""Measures and verdicts of results/omnisafe, from episodes whose measures are known by hand."""

import numpy as np
import omnisafe_parity
import pytest


@pytest.fixture
def records(tmp_path, monkeypatch):
    for side in omnisafe_parity.SIDES:
        (tmp_path / "records" / side).mkdir(parents=True)
    monkeypatch.setattr(omnisafe_parity, "RECORDS", tmp_path / "records")
    return tmp_path / "records"


def test_measures_of_recorded_steps(tmp_path, records, monkeypatch):
    """Forty episodes of two steps, ten per epoch, with returns 0, 1, ..., 39. The first step costs
    1, in the last epoch both do. The last tenth has four episodes. Rollouts start at steps 0, 20,
    40 and 60 of 80: two in the first third, one in each of the others."""
    costs = np.ones((40, 2))
    costs[:30, 1] = 0
    rewards = np.stack((np.arange(40.0), np.zeros(40)), axis=1)
    folder = tmp_path / "omnisafe" / "cpo-7"
    folder.mkdir(parents=True)
    end = np.tile([False, True], 40)
    np.savez(folder / "steps.npz", reward=rewards.ravel(), cost=costs.ravel(), end=end)
    monkeypatch.setattr(omnisafe_parity, "read_groups", lambda *_: [])
    omnisafe_parity.take_in(tmp_path)
    found = omnisafe_parity.measured(omnisafe_parity.runs("omnisafe", "cpo"))
    assert {name: values.tolist() for name, values in found.items()} == {
        "J_R": [(36 + 37 + 38 + 39) / 4],
        "J_C": [2.0],
        "cost_rate": [(30 + 20) / 80],
        "EMCC_0.33": [0.5],
        "EMCC_0.66": [0.5],
        "EMCC_0.99": [1.0],
    }


@pytest.mark.parametrize(
    ("ours", "margin", "verdict"),
    [
        ([10.1, 9.9, 10.0, 10.05], 1.0, "equal (p = .029)"),  # 1 of the 35 ways to divide seven
        ([20.1, 19.9, 20.0, 20.05], 1.0, "different (p = .029)"),
        ([10.0, 30.0, -10.0, 12.0], 1.0, "undecided"),
    ],
)
def test_verdicts(ours, margin, verdict):
    theirs = np.array([10.0, 10.02, 9.97])
    assert omnisafe_parity.compared(theirs, np.array(ours), margin).startswith(verdict)
