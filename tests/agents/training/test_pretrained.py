"""Policies that come with the package."""

import numpy as np
import pytest

import agents
from agents.training import pretrained as module
from agents.training.pretrained import write_policy

TASK = "Circle2D-2-v0"
OBSERVATIONS = np.random.default_rng(0).uniform(-1, 1, (20, 2)).astype(np.float32)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "x"
    small = {"gradient_steps": 1, "random_steps": 0, "batch_size": 32, "hidden": (32,)}
    agents.train("sac-lb", "Circle2D-1-v0", seeds=[3, 5], steps=100, out=folder, **small)
    return folder


def test_a_policy_alone_acts_as_in_its_runs(folder, tmp_path):
    write_policy(folder, 5, tmp_path / "policy")
    files = sorted(path.name for path in (tmp_path / "policy").iterdir())
    assert files == ["checkpoint.npz", "config.json"]
    alone = agents.load_policy(tmp_path / "policy")
    assert alone.seed == 5
    np.testing.assert_array_equal(
        alone(OBSERVATIONS), agents.load_policy(folder, seed=5)(OBSERVATIONS)
    )
    with pytest.raises(agents.UserError, match="exists already"):
        write_policy(folder, 3, tmp_path / "policy")
    with pytest.raises(agents.UserError, match=r"no run of seed 4: its seeds are \[3, 5\]"):
        write_policy(folder, 4, tmp_path / "other")


def test_found_by_algorithm_and_task(folder, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "FOLDER", tmp_path)
    write_policy(folder, 3, tmp_path / "sac-lb" / "Circle2D-1-v0")
    expected = tmp_path / "sac-lb" / "Circle2D-1-v0"
    assert agents.pretrained("sac-lb", "circle2d_mj:Circle2D-1-v0") == expected
    with pytest.raises(agents.UserError, match=r"no policy of 'sac-lbb'.*did you mean 'sac-lb'"):
        agents.pretrained("sac-lbb", "Circle2D-1-v0")
    with pytest.raises(
        agents.UserError, match=r"for 'Circle2D-7-v0'.*did you mean 'Circle2D-1-v0'"
    ):
        agents.pretrained("sac-lb", "Circle2D-7-v0")
    with pytest.raises(agents.UserError, match="for 'Circle2D-7-v0'"):
        agents.load_policy("pretrained:sac-lb/Circle2D-7-v0")


def test_those_of_the_package_do_what_the_readme_says():
    """TRPO-Lag goes straight through, SAC-LB-Streak ends in the corridor within the limit of 5."""
    through = agents.evaluate(f"pretrained:trpo-lag/{TASK}", episodes=30)
    kept = agents.load_policy(f"pretrained:sac-lb-streak/{TASK}")
    kept = agents.evaluate(kept, episodes=30)
    assert (through.costs >= 9).all()
    assert through.mcc >= 0.18
    assert (kept.costs <= 5).all()
    assert kept.mcc <= 0.06
    assert (kept.returns > -10).all()  # above the best that a cut-out allows
