"""Short trainings on tasks of the suite."""

import numpy as np
import pytest

import agents
import emcc

LEARNERS = {
    "SafetyPointGoal2-v0": "cpo",
    "SafetyCarCircle2-v0": "sac-lag",
    "SafetyHalfCheetahVelocity-v1": "sac-lag",
}
SMALL = {"cpo": {"episodes": 1, "critic_iterations": 2}, "sac-lag": {"random_steps": 200}}


@pytest.mark.slow
@pytest.mark.parametrize(("task", "algorithm"), LEARNERS.items())
def test_a_training(task, algorithm, tmp_path):
    """Two epochs with updates give finite returns and costs, recorded updates, and an EMCC."""
    runs = agents.train(
        algorithm,
        f"circle2d_mj/{task}",
        seeds=[0],
        steps=1000 if "Circle" in task else 2000,
        out=tmp_path / "run",
        evaluation_episodes=2,
        **SMALL[algorithm],
    )
    episodes = runs.to_pandas("episodes")
    assert len(episodes) == 2
    assert np.isfinite(episodes[["return", "cost"]].to_numpy()).all()
    updates = runs.to_pandas("updates")
    assert len(updates) > 0
    assert updates.select_dtypes("number").abs().to_numpy().sum() > 0
    assert 0.0 <= emcc.emcc(episodes["longest_streak"] / episodes["length"]) <= 1.0
