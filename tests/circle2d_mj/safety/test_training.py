"""Short trainings on a task of each family, by an algorithm on-policy and one off-policy."""

import numpy as np
import pytest

import agents

TASKS = {
    "Goal": "SafetyPointGoal2-v0",
    "Button": "SafetyPointButton1-v0",
    "Push": "SafetyPointPush1-v0",
    "Circle": "SafetyCarCircle2-v0",
    "Run": "SafetyPointRun0-v0",
    "Velocity": "SafetyHalfCheetahVelocity-v1",
}


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["cpo", "sac-lag"])
@pytest.mark.parametrize("family", TASKS)
def test_a_training_of_each_family(algorithm, family, tmp_path):
    """Its table has the run, with a cost that is a number."""
    runs = agents.train(
        algorithm,
        f"circle2d_mj/{TASKS[family]}",
        seeds=[0],
        steps=2000,
        out=tmp_path / "run",
        backend="eager",
    )
    frame = runs.to_pandas()
    assert len(frame) > 0
    numbers = frame.select_dtypes("number").to_numpy()
    assert np.isfinite(numbers).any()
