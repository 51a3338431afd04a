"""Short trainings on a task of each family, by an algorithm on-policy and one off-policy."""

import numpy as np
import pytest

import agents
import emcc
from agents.training import derive

TASKS = {
    "Goal": "SafetyPointGoal2-v0",
    "Button": "SafetyPointButton1-v0",
    "Push": "SafetyPointPush1-v0",
    "Circle": "SafetyCarCircle2-v0",
    "Run": "SafetyPointRun0-v0",
    "Velocity": "SafetyHalfCheetahVelocity-v1",
}
SMALL = {"cpo": {"episodes": 1, "critic_iterations": 2}, "sac-lag": {"random_steps": 200}}


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", SMALL)
@pytest.mark.parametrize("family", TASKS)
def test_a_training_of_each_family(algorithm, family, tmp_path, monkeypatch):
    """Two epochs with updates: returns, costs, what the updates tell, and EMCC are numbers."""
    monkeypatch.setattr(derive.write_results, "__defaults__", (2,))  # evaluated episodes, not 100
    steps = 1000 if family in ("Circle", "Run") else 2000
    runs = agents.train(
        algorithm,
        f"circle2d_mj/{TASKS[family]}",
        seeds=[0],
        steps=steps,
        out=tmp_path / "run",
        backend="eager",
        **SMALL[algorithm],
    )
    episodes = runs.to_pandas("episodes")
    assert len(episodes) == 2
    assert np.isfinite(episodes[["return", "cost"]].to_numpy()).all()
    updates = runs.to_pandas("updates")
    assert len(updates) > 0
    assert updates.select_dtypes("number").abs().to_numpy().sum() > 0
    assert 0.0 <= emcc.emcc(episodes["longest_streak"] / episodes["length"]) <= 1.0
