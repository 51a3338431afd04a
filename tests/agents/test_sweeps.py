"""Sweeps over hyper-parameters, in local processes and on Ray."""

import importlib
import os
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import toys
from small_runs import results

import agents
from agents.api import combinations_of
from agents.errors import RunsFailed


def test_every_combination_has_a_name():
    found = combinations_of({"cost_limit": (1.0,), "hidden": ((8, 8), (16,))})
    assert found == {
        "cost_limit=1.0,hidden=8x8": {"cost_limit": 1.0, "hidden": (8, 8)},
        "cost_limit=1.0,hidden=16": {"cost_limit": 1.0, "hidden": (16,)},
    }
    assert list(combinations_of({"cost_limit": np.linspace(1, 3, 2)})) == [
        "cost_limit=1.0",
        "cost_limit=3.0",
    ]


@pytest.mark.parametrize("letter", ["h", "\N{GREEK SMALL LETTER PI}"])
def test_names_of_many_values_fit_a_folder(tmp_path, letter):
    """The names differ from each other and are the same in every call."""
    many = {"hidden": ([300] * 90, [300] * 89 + [301]), letter * 60: (1, 2)}
    names = list(combinations_of(many))
    assert names == list(combinations_of(many))
    assert len(set(names)) == 4
    for name in names:
        (tmp_path / name).mkdir()
        assert name.startswith("hidden=300x300x")


BAD = {
    "no values": ({"cost_limit": ()}, r"grid needs several values of cost_limit, got \(\)"),
    "beside": ({"episodes": (1, 2)}, "episodes is given twice: in the grid, and as 3"),
    "one value": ({"cost_limit": 3.0}, "grid needs several values of cost_limit, got 3.0"),
    "twice": ({"cost_limit": (1.0, 1.0)}, "grid has cost_limit=1.0 twice"),
    "nothing": ({}, "grid is empty"),
    "no names": ([1.0, 2.0], r"grid must be values by the names .*, got \[1.0, 2.0\]"),
    "setting": ({"steps": (100, 200)}, "hyper-parameters; steps is the same for a whole sweep"),
    "unknown": ({"cost_limits": (1.0, 2.0)}, r"did you mean 'cost_limit'\?"),
}


@pytest.mark.parametrize(("grid", "message"), BAD.values(), ids=BAD)
def test_mistakes_are_named(tmp_path, grid, message):
    with pytest.raises(agents.UserError, match=message):
        agents.sweep("cpo", grid=grid, steps=1000, episodes=3, out=tmp_path / "x")
    assert not (tmp_path / "x").exists()


MODULE = """
import gymnasium
from toys import Walk
class Mine(Walk):
    pass
gymnasium.register("OfAModule-v0", Mine, max_episode_steps=40)
"""


@pytest.fixture
def importable(tmp_path, monkeypatch):
    """A folder from which this process and its child processes import modules."""
    monkeypatch.syspath_prepend(tmp_path)
    path = os.pathsep.join([str(tmp_path), str(Path(toys.__file__).parent)])
    monkeypatch.setenv("PYTHONPATH", path, prepend=os.pathsep)
    return tmp_path


def test_a_sweep_on_a_task_from_a_users_module(importable):
    """Its processes import the module, though the task's id does not name it.

    Settings that are no hyper-parameters work as in `train`. A folder of a sweep with other
    settings is refused.
    """
    (importable / "my_walk.py").write_text(MODULE)
    importlib.import_module("my_walk")
    settings = {"checkpoint_every": 50, "evaluate_every": 50, "task_parameters": {"scale": 2.0}}
    more = {"grid": {"cost_limit": (2.0,)}, "steps": 100, "seeds": 0, "out": importable / "x"}
    try:
        runs = agents.sweep("cpo", "OfAModule-v0", episodes=1, **settings, **more)
        [config] = runs.configs
        assert config.hyperparameters.cost_limit == 2.0
        assert {name: getattr(config, name) for name in settings} == settings
        assert agents.load_policy(runs.folders[0], step=50).step == 50
        assert runs.records[runs.folder, 0].total_steps >= 100
        words = r"other settings: .*algorithm cpo \(now sac-lb\).*episodes 1 \(now absent\)"
        with pytest.raises(agents.UserError, match=words) as raised:
            agents.sweep("sac-lb", "OfAModule-v0", **more)
        assert "replay_size absent (now 50000)" in str(raised.value)
    finally:
        gym.registry.pop("OfAModule-v0", None)
        sys.modules.pop("my_walk", None)


def test_a_sweep_on_a_task_of_the_running_script_is_refused(tmp_path, monkeypatch):
    class Script(toys.Walk):
        pass

    monkeypatch.setattr(Script, "__module__", "__main__")
    words = "OfAScript-v0 is registered in the running"
    with toys.registered(OfAScript=Script), pytest.raises(agents.UserError, match=words):
        agents.sweep("cpo", "OfAScript-v0", grid={"cost_limit": (1.0,)}, out=tmp_path / "x")
    assert not (tmp_path / "x").exists()


def test_a_sweep_names_the_error_and_the_line_of_a_training_that_failed(importable):
    (importable / "my_toys.py").write_text("import toys\n\ntoys.register()\n")
    more = {"grid": {"cost_limit": (1.0,)}, "steps": 50, "episodes": 1, "seeds": 0}
    more |= {"task_parameters": {"how": "raise", "at": 5}, "out": importable / "x"}
    words = r"cost_limit=1.0 failed: .*LookupError: motor .*toys\.py, line \d+"
    with pytest.raises(RunsFailed, match=words):
        agents.sweep("cpo", "my_toys:Broken-v0", backend="numpy", **more)


def test_a_grid_warns_of_runs_that_failed_beside_others(importable):
    """The others count, as with `train`. With these seeds two runs of three meet a NaN."""
    (importable / "my_toys.py").write_text("import toys\n\ntoys.register()\n")
    more = {"steps": 200, "episodes": 1, "seeds": range(3), "backend": "numpy"}
    more |= {"task_parameters": {"poison": 0.0005}, "out": importable / "x"}
    for _ in range(2):  # trained, and there
        with pytest.warns(agents.errors.FailedRunWarning, match=r"seed [01]: .* not finite"):
            runs = agents.grid("cpo", "my_toys:Walk-v0", **more)
        with pytest.warns(UserWarning, match="left out"):
            assert [run.seed for group in runs.results for run in group.runs] == [2]


def test_a_sweep_goes_on_with_a_tuple_in_its_task_parameters(importable):
    (importable / "my_toys.py").write_text("import toys\n\ntoys.register()\n")
    more = {"grid": {"cost_limit": (1.0,)}, "steps": 50, "episodes": 1, "seeds": 0}
    more |= {"task_parameters": {"scale": (1.0, 2.0)}, "out": importable / "x"}
    for _ in range(2):
        [config] = agents.sweep("cpo", "my_toys:Walk-v0", backend="numpy", **more).configs
        assert config.task_parameters == {"scale": [1.0, 2.0]}


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["local", "ray"])
def test_a_sweep_gives_the_files_of_single_trainings(tmp_path, engine):
    if engine == "ray":
        pytest.importorskip("ray")
    options = {"seeds": (0, 1), "steps": 1500, "evaluation_episodes": 3}  # as this process does
    more = {"grid": {"cost_limit": (1.0, 9.0)}, "out": tmp_path / "s", "engine": engine} | options
    runs = agents.sweep("trpo-lag", **more)
    assert [folder.name for folder in runs.folders] == ["cost_limit=1.0", "cost_limit=9.0"]
    alone = agents.train("trpo-lag", cost_limit=9.0, out=tmp_path / "alone", **options)
    assert results(runs.folders[1]) == results(alone.folder)
    before = (runs.folders[0] / "results.npz").stat().st_mtime_ns
    agents.sweep("trpo-lag", **more)
    assert (runs.folders[0] / "results.npz").stat().st_mtime_ns == before


@pytest.mark.slow
def test_training_on_ray(tmp_path):
    pytest.importorskip("ray")
    options = {"seeds": 0, "steps": 1500, "evaluation_episodes": 3}
    local, ray = (
        agents.train("trpo-lag", out=tmp_path / name, engine=name, **options).folder
        for name in ("local", "ray")
    )
    assert results(ray) == results(local)
