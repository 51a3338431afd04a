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
    """Every episode has a return and a cost that are numbers."""
    runs = agents.train(
        algorithm,
        f"circle2d_mj/{TASKS[family]}",
        seeds=[0],
        steps=2000,
        out=tmp_path / "run",
        backend="eager",
    )
    episodes = runs.to_pandas("episodes")
    assert len(episodes) > 0
    assert np.isfinite(episodes[["return", "cost"]].to_numpy()).all()
