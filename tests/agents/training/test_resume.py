"""Trainings that stop or are killed go on as if never interrupted, bit for bit."""

import numpy as np
import pytest
from small_runs import SAC, TRPO, results

import agents

OPTIONS = {"seeds": (3, 4), "steps": 240, "checkpoint_every": 60, "evaluate_every": 100}
FAMILIES = {"cpo": TRPO, "sac-lag": SAC}
"""Every other one stops once in test_families.py."""


def trained(out, algorithm, task="Walk-v0", **more):
    return agents.train(algorithm, task, out=out, **OPTIONS, **FAMILIES[algorithm], **more).folder


@pytest.mark.parametrize("algorithm", FAMILIES)
def test_a_stop_after_any_epoch(tmp_path, algorithm):
    """Episodes end early, observations are float64; the parameters are compared too."""
    expected = results(trained(tmp_path / "whole", algorithm))
    broken, stops = tmp_path / "broken", []

    def stop(epoch):
        stops.append(epoch.runs)
        return np.bool_(False)

    trained(broken, algorithm, on_epoch=stop)
    while not (broken / "results.npz").exists():
        agents.resume(broken, on_epoch=stop)
        assert len(stops) < 50
    assert len(stops) > 2
    assert results(broken) == expected


def test_an_epoch_is_kept_whose_follower_raises(tmp_path):
    """Its checkpoint is there; that any checkpoint leads to the same end: see above."""
    epochs = []

    def fail(epoch):
        epochs.append(epoch.runs[3]["step"])
        raise LookupError("a tracker that is gone")

    for go in (trained, lambda folder, _, **how: agents.resume(folder, **how)):
        with pytest.raises(LookupError, match="a tracker"):
            go(tmp_path / "x", "cpo", on_epoch=fail)
        assert agents.load_policy(tmp_path / "x", seed=3).step == epochs[-1]
    assert epochs[1] > epochs[0]
