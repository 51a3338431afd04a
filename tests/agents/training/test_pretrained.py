"""Policies that come with the package."""

import shutil

import numpy as np
import pytest
from small_runs import SAC

import agents
from agents.training import policy as module

TASK = "Circle2D-2-v0"


def test_found_by_algorithm_and_task(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "FOLDER", tmp_path)
    expected = tmp_path / "sac-lb" / "Circle2D-1-v0"
    trained = agents.train("sac-lb", "Circle2D-1-v0", seeds=3, steps=100, **SAC)
    shutil.copytree(trained.folder, expected)
    assert agents.pretrained("sac-lb", "circle2d_mj:Circle2D-1-v0") == expected
    policies = [agents.load_policy(of) for of in (trained, "pretrained:sac-lb/Circle2D-1-v0")]
    np.testing.assert_array_equal(*(policy(np.ones((3, 2))) for policy in policies))
    for algorithm, task, words in (
        ("sac-lbb", "Circle2D-1-v0", r"no policy of 'sac-lbb'.*did you mean 'sac-lb'"),
        ("sac-lb", "Circle2D-7-v0", r"for 'Circle2D-7-v0'.*did you mean 'Circle2D-1-v0'"),
    ):
        with pytest.raises(agents.UserError, match=words):
            agents.pretrained(algorithm, task)
        with pytest.raises(agents.UserError, match=words):
            agents.load_policy(f"pretrained:{algorithm}/{task}")


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
