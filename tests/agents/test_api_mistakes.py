"""Mistakes in the arguments of `agents.train`: one line each, and nothing is written."""

import shutil
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import agents
from agents import api


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"log_barier_factor": 3.0}, "no hyper-parameter 'log_barier_factor': did you mean 'log"),
        ({"step": 3}, "no hyper-parameter 'step': did you mean 'steps'"),
        ({"lr": 3}, "no hyper-parameter 'lr': did you mean 'learning_rate'"),
        ({"total_timesteps": 3}, "no hyper-parameter 'total_timesteps': did you mean 'steps'"),
        ({"hidden": 64}, r"hidden must be a tuple of integers, .*, got 64"),
        ({"task": gym.Env()}, "task must be the id of a gymnasium task, like 'Circle2D-1', got"),
        (
            {"algorithm": agents.Algorithm},
            "algorithm must be a name, like 'sac-lag', got",
        ),
        ({"discount": np.float32(0.9)}, "hyperparameters must be plain values: .*float32"),
        ({"xyzzy": 3}, "no hyper-parameter 'xyzzy': it has .*cost_limit"),
        ({"algorithm": "sac-lib"}, "unknown algorithm 'sac-lib'"),
        ({"task": "Nowhere-v0"}, "unknown task 'Nowhere-v0'"),
        ({"seeds": "ab"}, "seeds must be an integer or several, got 'ab'"),
        ({"seeds": []}, "seeds must be"),
        ({"seeds": 1.5}, "seeds must be an integer or several, got 1.5"),
        ({"steps": 0}, "steps must be at least 1"),
        ({"evaluate_every": 0}, "evaluate_every must be at least 1"),
        ({"evaluate_every": 2.5}, "evaluate_every must be an integer"),
        ({"task_parameters": {"level": 3}}, "level is part of the task's id"),
        ({"vectorization": "threads"}, "vectorization must be auto or sync or async"),
        ({"backend": "fast"}, "backend must be compiled or eager"),
        ({"step_timeout": 1e-9}, "step_timeout is for processes: .* async, got auto"),
        ({"step_timeout": 1.0, "vectorization": "sync"}, "must be async, got sync"),
        ({"task_parameters": [1]}, r"task_parameters must be values by name, got \[1\]"),
        ({"on_epoch": 3}, "on_epoch must be a function of an Epoch, got 3"),
        ({"out": 3}, "out must be a folder, got 3"),
        ({"out": ""}, "out must be a folder, got ''"),
        ({"task": []}, "task must be the id of a gymnasium task"),
        ({"costs": ("cost", "nothing")}, r"gives no info\['nothing'\]"),
        ({"tasks": ["Circle2D-1"]}, "no hyper-parameter 'tasks': did you mean 'task'"),
        ({"engine": "cloud"}, "engine must be local or ray, got 'cloud'"),
        ({"engine": "ray", "on_epoch": print}, "on_epoch and progress are of the engine local"),
        ({"address": "10.0.0.1:1"}, "address is of a Ray cluster"),
        ({"out": Path(__file__) / "x"}, "out must be a folder, but '.*py' is a file"),
    ],
)
def test_mistakes(arguments, message, tmp_path, monkeypatch):
    """Nothing is written, neither there nor into the folder where it is called."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(agents.UserError, match=message):
        agents.train(**{"algorithm": "sac-lb", "steps": 50, "out": tmp_path / "x", **arguments})
    assert not list(tmp_path.iterdir())


def test_a_refusal_leaves_nothing_in_the_folder(tmp_path):
    shutil.copy(agents.pretrained("trpo-lag", "Circle2D-2-v0") / "config.json", tmp_path)
    with pytest.raises(agents.UserError, match="holds runs already"):
        agents.train("cpo", out=tmp_path)
    assert {path.name for path in tmp_path.iterdir()} <= {"config.json", ".lock"}


def test_a_file_in_the_way_is_found_before_anything_slow(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("kept")

    def slow(*args):
        raise AssertionError("the compiler is asked")

    monkeypatch.setattr(api.lockstep_backend, "choose", slow)
    for call in (agents.train, lambda *a, **k: agents.sweep(*a, grid={"cost_limit": (1.0,)}, **k)):
        for out in (tmp_path / "file", tmp_path / "file" / "x"):
            with pytest.raises(agents.UserError, match=r"out must be a folder, but .*file' is a f"):
                call("cpo", out=out)
    assert [path.read_text() for path in tmp_path.iterdir()] == ["kept"]
