"""Trainings that were stopped, or are made longer, end as if never interrupted, bit for bit."""

import re

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.spaces import Box
from small_runs import SAC, TRPO, results
from toys import Walk

import agents
from agents.cli.main import main
from agents.errors import UserError

OPTIONS = {"seeds": (3, 4), "steps": 240, "checkpoint_every": 60, "evaluate_every": 100}
FAMILIES = {"cpo": TRPO, "sac-lag": SAC}
"""The other algorithms are stopped once in test_families.py."""


def trained(out, algorithm, task="Walk-v0", **more):
    more = OPTIONS | FAMILIES[algorithm] | more
    return agents.train(algorithm, task, out=out, **more).folder


@pytest.mark.parametrize("algorithm", FAMILIES)
def test_a_stop_after_any_epoch(tmp_path, algorithm):
    """Episodes end early and observations are float64; checkpoints are compared, too."""
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


class Shorter(Walk):
    """A walk that observes x alone."""

    observation_space = Box(-np.inf, np.inf, (1,), np.float64)

    def observation(self):
        return super().observation()[:1]


class Unlike(Walk):
    """A walk whose cost has another name."""

    def step(self, action):
        *step, info = super().step(action)
        return *step, {"kosten": info["cost"]}


CHANGED = {
    "observation": (Shorter, "has changed since .*observation_size=2.*observation_size=1"),
    "scale": (type("Wide", (Walk,), {"action_space": Box(-8, 8, (1,))}), r"low=\(-8\.0,\)"),
    "actions": (type("Two", (Walk,), {"action_space": Box(-2, 2, (2,))}), r"low=\(-2\.0, -2\.0\)"),
    "cost": (Unlike, r"gives no info\['cost'\]"),
}


@pytest.mark.parametrize("how", CHANGED)
def test_a_task_that_has_changed_costs_no_run(tmp_path, monkeypatch, capsys, how):
    """The training is refused, since its runs would fail for good or act at another scale. Once the
    task is as before, it goes on as if the task had never changed."""
    other, words = CHANGED[how]
    expected = results(trained(tmp_path / "whole", "cpo"))
    broken = trained(tmp_path / "x", "cpo", on_epoch=lambda epoch: False)
    with monkeypatch.context() as patch:
        patch.setattr(gym.spec("Walk-v0"), "entry_point", other)
        with pytest.raises(UserError, match=words):
            agents.resume(broken)
        assert main(["evaluate", str(broken), "--episodes", "1"]) == 2
    assert re.search(words, capsys.readouterr().err)
    assert results(agents.resume(broken).folder) == expected
    monkeypatch.setattr(gym.spec("Walk-v0"), "entry_point", other)
    with pytest.raises(UserError, match=words):
        agents.resume(broken, steps=500)
    assert results(broken) == expected


def test_an_epoch_whose_callback_raises_is_saved(tmp_path):
    epochs = []

    def fail(epoch):
        epochs.append(epoch.runs[3]["step"])
        raise LookupError("a tracker that is gone")

    for go in (trained, lambda folder, _, **how: agents.resume(folder, **how)):
        with pytest.raises(LookupError, match="a tracker"):
            go(tmp_path / "x", "cpo", on_epoch=fail)
        assert agents.load_policy(tmp_path / "x", seed=3).step == epochs[-1]
    assert epochs[1] > epochs[0]


@pytest.mark.parametrize(
    ("algorithm", "task"), [("cpo", "Circle2D-1-v0"), ("sac-lag", "Circle2D-1-v0")]
)
def test_a_finished_training_goes_on(algorithm, task, tmp_path):
    """All files are those of a training of that length: results, the newest checkpoint, policies
    from during training, and config.json. The same number of steps again changes nothing."""
    expected = results(trained(tmp_path / "whole", algorithm, task, steps=600))
    folder = trained(tmp_path / "x", algorithm, task, steps=230)
    before = results(folder)
    assert results(agents.resume(folder, steps=230).folder) == before
    for steps in (400.0, 600, 600):
        agents.resume(folder, steps=steps)
    assert results(folder) == expected
    for steps, words in ((599, "at least the 600 that .* has, got 599"), (0, "at least 1, got 0")):
        with pytest.raises(agents.UserError, match=f"steps must be {words}"):
            agents.resume(folder, steps=steps)
    assert results(folder) == expected


def test_a_longer_training_that_needs_no_further_epoch(tmp_path):
    """230 and 480 steps are both an epoch of ten episodes of 50 steps, so that only the results'
    parts of training differ."""
    more = {"seeds": (3, 4), "episodes": 10} | {k: v for k, v in TRPO.items() if k != "episodes"}
    how = {"algorithm": "cpo", "task": "Circle2D-1-v0", **more}
    expected = agents.train(**how, steps=480, out=tmp_path / "whole").folder
    folder = agents.train(**how, steps=230, out=tmp_path / "x").folder
    assert results(folder) != results(expected)
    agents.resume(folder, steps=480)
    assert results(folder) == results(expected)


@pytest.mark.parametrize("algorithm", FAMILIES)
def test_runs_that_waited_for_others_catch_up(algorithm, tmp_path):
    """Where episodes end early, runs are done after different numbers of epochs; the training is
    also stopped while they catch up. test_families.py has every algorithm."""
    how = {"seeds": (3, 4, 5)}
    expected = results(trained(tmp_path / "whole", algorithm, steps=600, **how))
    folder = trained(tmp_path / "x", algorithm, steps=250, **how)
    counts = agents.load_runs(folder).to_pandas("updates").groupby("seed").size()
    assert counts.nunique() > 1
    caught = []

    def stop(epoch):
        caught.append(sorted(epoch.runs))
        return False

    agents.resume(folder, steps=400, on_epoch=stop)
    agents.resume(folder, steps=600, on_epoch=stop)
    agents.resume(folder)
    assert [len(runs) < 3 for runs in caught] == [True, True]
    assert results(folder) == expected
