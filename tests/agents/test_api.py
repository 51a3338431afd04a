"""The Python interface: what it returns, what it leaves unchanged in the process, its errors."""

import dataclasses
import doctest
import gc
import shutil
import signal
from fractions import Fraction

import numpy as np
import pandas
import pytest
import torch
from small_runs import TRPO, results, write_evaluated
from toys import register as register_toys

import agents
from agents import api
from agents.cli.main import main
from agents.presets import preset
from agents.results.archive import write_archive
from agents.training.config import TrainConfig

register_toys()
SMALL = TRPO | {"seeds": [3, 4], "steps": 300}


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    return agents.train("trpo-lag", out=tmp_path_factory.mktemp("api") / "runs", **SMALL)


def test_public_names_are_listed_and_documented():
    assert set(agents.__all__) <= set(dir(agents))
    for name in agents.__all__:
        assert getattr(agents, name).__doc__
    with pytest.raises(AttributeError, match="no attribute 'teach'"):
        _ = agents.teach


def test_the_examples_in_docstrings_run():
    assert doctest.testmod(api, raise_on_error=True).attempted >= 7


def test_runs_stand_for_their_folder(runs, tmp_path):
    assert repr(runs) == f"Runs({str(runs.folder)!r})"
    assert runs.config == TrainConfig.read(runs.folder)
    assert agents.load_policy(runs, seed=3).seed == 3
    assert agents.evaluate(runs, episodes=1).costs.shape == (2, 1)
    assert agents.load_runs(runs).folders == runs.folders
    assert agents.resume(runs).folder == runs.folder
    copy = shutil.copytree(runs.folder, tmp_path / "copy")
    both = agents.load_runs(runs, copy)
    assert both.folders == (runs.folder, copy)
    with pytest.raises(agents.UserError, match="there are several folders"):
        agents.load_policy(both)


def test_frames_have_the_numbers_of_results_and_records(runs):
    frame = runs.to_pandas()
    assert {"task", "algorithm", "seed", "measure", "part", "value"} <= set(frame.columns)
    [group] = runs.results
    for seed, run in enumerate(group.runs, 3):
        own = frame[(frame.seed == seed) & (frame.measure == "J_R")]
        assert own.value.tolist() == [run.measures["J_R"]]
    episodes = runs.to_pandas("episodes")
    own = episodes[episodes.seed == 4]
    np.testing.assert_array_equal(own["cost"], runs.records[runs.folder, 4].cost)
    np.testing.assert_array_equal(own["start_step"], np.arange(0, 300, 50))
    updates = runs.to_pandas("updates")
    assert updates[updates.seed == 3]["step"].tolist() == [100, 200, 300]
    assert updates["kl"].between(0, 0.1).all()
    with pytest.raises(agents.UserError, match="rows must be measures, episodes, updates"):
        runs.to_pandas("runs")


def test_a_run_killed_before_its_first_epoch_hides_no_other(runs, tmp_path):
    """It has no episodes; records and frames are, bit for bit, those of the other runs."""
    shutil.copytree(runs.folder, tmp_path / "whole")
    dataclasses.replace(runs.config, seeds=(5,)).write(tmp_path / "killed")
    both = agents.load_runs(tmp_path)
    lengths = [len(of_run) for of_run in both.records.values()]
    assert lengths == [0, 6, 6]
    for rows in ("episodes", "updates", "evaluations"):
        expected = runs.to_pandas(rows).assign(folder="whole")
        pandas.testing.assert_frame_equal(both.to_pandas(rows), expected)
        assert agents.load_runs(tmp_path / "killed").to_pandas(rows).empty
    with pytest.warns(UserWarning, match="killed, seed 5: has no recorded episodes"):
        assert both.to_pandas().equals(runs.to_pandas().assign(folder="whole"))


def test_an_archive_is_opened_as_its_folder_is(runs, tmp_path):
    write_archive(tmp_path / "runs.zip", runs.results)
    packed = agents.load_runs(tmp_path / "runs.zip")
    assert packed.table() == runs.table()
    columns = ["task", "seed", "rollout", "step", "multiplier"]  # an archive has no other metric
    updates = packed.to_pandas("updates")
    assert set(updates) == {"folder", "algorithm", *columns}
    expected = runs.to_pandas("updates")[columns]
    pandas.testing.assert_frame_equal(updates[columns], expected, check_dtype=False)
    with pytest.raises(agents.UserError, match=r"runs.zip.* is no folder: only .* read archives"):
        agents.resume(packed)


def test_folders_that_differ_in_a_setting_are_told_apart(tmp_path):
    """Every episode of ten steps has as many cost steps as written here."""
    costs = {(32, 32): (1, 2), (64,): (3, 4)}
    for hidden, each in costs.items():
        changed = dataclasses.replace(preset("sac-lag", "Circle2D-1-v0"), hidden=hidden)
        write_evaluated(tmp_path / "nets" / str(len(hidden)), "sac-lag", each, changed)
    runs = agents.Runs([tmp_path / "nets" / "2", tmp_path / "nets" / "1"])
    assert [group.folder for group in runs.results] == ["2", "1"]
    frame = runs.to_pandas("episodes")
    assert set(frame.columns[:5]) == {"folder", "algorithm", "task", "hidden", "seed"}
    found = frame.groupby(["hidden", "seed"]).cost.mean().to_dict()
    assert found == {(k, seed): each[seed] for k, each in costs.items() for seed in (0, 1)}
    measures = runs.to_pandas()
    rates = measures[measures.measure == "cost_rate"].value.tolist()
    assert rates == pytest.approx([0.1, 0.2, 0.3, 0.4])


def test_settings_of_an_algorithm_that_is_not_imported_are_told_apart(tmp_path):
    """The mean by settings, as a page of the docs computes it, of the cost steps written here.

    `compare` names the settings, too. A folder without complete runs is left out with a warning.
    """
    for hidden, each in {(32, 32): (1, 2), (64,): (3, 4)}.items():
        changed = dataclasses.replace(preset("sac-lag", "Circle2D-1-v0"), hidden=hidden)
        folder = tmp_path / "nets" / str(len(hidden))
        write_evaluated(folder, "sac-lag", each, changed)
        config = (folder / "config.json").read_text()
        (folder / "config.json").write_text(config.replace('"sac-lag"', '"sac-own"'))
    young = tmp_path / "nets" / "young"
    agents.train("cpo", seeds=0, steps=5000, out=young, on_epoch=lambda epoch: False)
    with pytest.warns(UserWarning, match="left out: young holds no complete runs"):
        frame = agents.load_runs(tmp_path / "nets").to_pandas()
    assert len(agents.load_runs(tmp_path / "nets").to_pandas("episodes"))
    rates = frame[frame.measure == "cost_rate"].groupby("settings").value.agg(["mean", "count"])
    expected = {"100 steps, hidden (32, 32)": (0.15, 2), "100 steps, hidden (64,)": (0.35, 2)}
    assert rates.index.tolist() == sorted(expected)
    for name, (mean, count) in expected.items():
        assert tuple(rates.loc[name]) == (pytest.approx(mean), count)
    told = agents.compare(tmp_path / "nets" / "1", tmp_path / "nets" / "2")
    assert "B - A: sac-own (hidden (32, 32)) - sac-own (hidden (64,))" in told
    shutil.rmtree(tmp_path / "nets" / "1")
    with pytest.raises(agents.UserError, match="young holds no complete runs"):
        agents.load_runs(young).to_pandas()


def test_finished_runs_are_opened_again(runs, tmp_path):
    """By a string, by a folder above, or without the module of a user-defined algorithm."""
    for name in "xy":
        shutil.copytree(runs.folder, tmp_path / "a" / name)
    again = agents.load_runs(str(tmp_path / "a"))
    assert again.folders == (tmp_path / "a" / "x", tmp_path / "a" / "y")
    above = again.folders[1] / ".." / "x"  # the same folder by another path
    one = agents.load_runs(str(again.folders[0]), again.folders[0], above)
    assert (one.config, one.folder) == (runs.config, again.folders[0])
    assert one.results[0].runs[0].measures == runs.results[0].runs[0].measures
    path = again.folders[1] / "config.json"
    path.write_text(path.read_text().replace('"trpo-lag"', '"trpo-own"'))
    own = agents.load_runs(path.parent)
    assert (own.config.algorithm, own.config.hyperparameters.episodes) == ("trpo-own", 2)
    assert len(own.records) == 2
    path.write_text("{")
    for folders, message in {
        (): "needs a folder",
        (tmp_path / "no",): "no is no folder",
        (tmp_path / "a" / "x" / "steps",): "steps holds no runs",
        (tmp_path,): "config.json",
    }.items():
        with pytest.raises(agents.UserError, match=message):
            agents.load_runs(*folders)
    for call, message in (
        (lambda: agents.Runs("runs"), "takes a list of folders, got 'runs'"),
        (lambda: agents.resume(["a", "b"]), r"folders one by one, .* got \['a', 'b'\]"),
        (agents.resume, "needs a folder"),
    ):
        with pytest.raises(agents.UserError, match=message):
            call()


def test_as_many_episodes_are_evaluated_as_are_asked_for(tmp_path, capsys):
    one = {"seeds": 0, "steps": 50, "evaluation_episodes": 2, "out": tmp_path / "x"}
    agents.train("trpo-lag", **TRPO | one)
    assert main(["evaluate", str(tmp_path / "x")]) == 0
    assert "means over 2 episodes" in capsys.readouterr().out
    with np.load(tmp_path / "x" / "results.npz") as arrays:
        for policy in ("deterministic", "stochastic"):
            assert len(arrays[f"Circle2D-1-v0/0/evaluation/{policy}/costs"]) == 2


def test_a_temporary_folder_lives_as_long_as_the_runs():
    runs = agents.train("trpo-lag", **TRPO | {"seeds": 5, "steps": 50})
    folder = runs.folder
    assert runs.config.seeds == (5,)
    assert (folder / "results.npz").exists()
    runs = agents.load_runs(agents.resume(runs, steps=100))
    gc.collect()
    assert runs.records[folder, 5].total_steps == 100
    del runs
    gc.collect()
    assert not folder.exists()


def test_epochs_are_plain_numbers_by_seed(tmp_path):
    epochs = []
    runs = agents.train("trpo-lag", out=tmp_path / "x", on_epoch=epochs.append, **SMALL)
    assert [epoch.runs[4]["step"] for epoch in epochs] == [100, 200, 300]
    records = runs.records[runs.folder, 4]
    for k, epoch in enumerate(epochs):
        numbers, own = epoch.runs[4], slice(2 * k, 2 * k + 2)
        assert (epoch.folder, epoch.algorithm, epoch.steps) == (tmp_path / "x", "trpo-lag", 300)
        assert all(type(value) is float for value in numbers.values())
        assert numbers["return"] == records.reward[own].mean()
        assert numbers["cost"] == records.cost[own].mean()
        assert numbers["mcc"] == records.longest_streak[own].max() / 50
        assert "kl" in numbers
    assert agents.train("trpo-lag", **SMALL, on_epoch=lambda epoch: 0).results  # 0 is not False


def test_epochs_of_several_tasks(tmp_path):
    epochs, tasks = [], ["Circle2D-1", "Circle2D-2-v0"]
    more = SMALL | {"out": tmp_path / "x", "on_epoch": epochs.append}
    runs = agents.train("trpo-lag", tasks, **more)
    assert epochs[0].task == "Circle2D-1-v0 Circle2D-2-v0"
    keys = {(f"Circle2D-{level}-v0", seed) for level in (1, 2) for seed in (3, 4)}
    assert set(epochs[0].runs) == keys
    assert {key[1:] for key in runs.records} == keys
    assert [group.task for group in runs.results] == ["Circle2D-1-v0", "Circle2D-2-v0"]
    assert set(runs.to_pandas("episodes").task) == {"Circle2D-1-v0", "Circle2D-2-v0"}
    for task, words in ((None, "give the task"), ("Circle2D-2-v0", "give the seed")):
        with pytest.raises(agents.UserError, match=words):
            agents.load_policy(runs, task=task)


def test_several_folders_are_resumed_one_after_the_other(tmp_path):
    folders = [tmp_path / "a", tmp_path / "b"]
    for seed, folder in enumerate(folders):
        more = SMALL | {"seeds": seed, "out": folder, "on_epoch": lambda epoch: False}
        agents.train("trpo-lag", **more)
    epochs = []
    runs = agents.resume(*folders, folders[0], on_epoch=epochs.append)
    assert runs.folders == tuple(folders)
    assert [epoch.folder.name for epoch in epochs] == ["a", "a", "b", "b"]
    assert {folder.name: seed for folder, seed in runs.records} == {"a": 0, "b": 1}
    again = []
    agents.resume(*folders, on_epoch=again.append)
    assert again == []


def state_of_process():
    matmul = getattr(torch.backends.mkldnn, "matmul", None)
    return {
        "threads": torch.get_num_threads(),
        "device": torch.tensor(0.0).device,
        "precision": torch.get_float32_matmul_precision(),
        "onednn": getattr(matmul, "fp32_precision", None),
        "dtype": torch.get_default_dtype(),
        "deterministic": torch.are_deterministic_algorithms_enabled(),
        "torch random": torch.get_rng_state().tolist(),
        "numpy random": np.random.get_state()[1].tolist(),  # noqa: NPY002
        "signals": [signal.getsignal(s) for s in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)],
    }


@pytest.mark.parametrize("raises", [False, True])
def test_training_leaves_the_state_of_the_process_as_it_was(tmp_path, raises):
    def fail(epoch):
        during.append(torch.get_num_threads())
        if raises:
            raise RuntimeError("in the middle")

    during, threads = [], torch.get_num_threads()
    matmul = getattr(torch.backends.mkldnn, "matmul", None)
    precision = getattr(matmul, "fp32_precision", None)
    try:
        torch.set_num_threads(2)
        if precision is not None:
            matmul.fp32_precision = "ieee"
        before = state_of_process()
        with pytest.raises(RuntimeError, match="in the middle") if raises else open("/dev/null"):
            more = SMALL | {"steps": 50, "out": tmp_path / "x", "on_epoch": fail}
            agents.train("cpo", **more)
        assert state_of_process() == before
    finally:
        torch.set_num_threads(threads)
        if precision is not None:
            matmul.fp32_precision = precision
    assert during == [1]


def test_the_runs_are_those_of_the_command(runs, tmp_path, capsys):
    options = ["--episodes", "2", "--hidden", "8", "--critic-iterations", "2"]
    options += ["--seeds", "3", "4", "--steps", "300"]
    command = ["train", "trpo-lag", *options, "--backend", "numpy", "--out", str(tmp_path / "x")]
    assert main(command) == 0
    assert results(tmp_path / "x") == results(runs.folder)
    assert "mean of 2" in capsys.readouterr().out


def test_iterables_are_read_once(tmp_path):
    def once(*values):
        return (value for value in values)

    tasks, several = ("Circle2D-1-v0", "Circle2D-2-v0"), ("trpo-lag", "cpo")
    settings = {"seeds": once(0, 3), "costs": once("cost")}
    own = once(*several), once(*tasks), tmp_path, "paper", "numpy", settings
    found = api.grid_configs(*own)
    assert [config.algorithm for config in found.values()] == [*several, *several]
    assert {(config.seeds, config.costs) for config in found.values()} == {((0, 3), ("cost",))}
    assert api.of_zoo(api.ids_of(once("Circle2D-0-v0")), "zoo")[0] == "sac-lb-streak"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"log_barier_factor": 3.0}, "no hyper-parameter 'log_barier_factor': did you mean 'log"),
        ({"grid": 3}, "no hyper-parameter 'grid': it has"),
        ({"total_timesteps": 3}, "no hyper-parameter 'total_timesteps': did you mean 'steps'"),
        ({"algorithm": agents.Algorithm}, "algorithm must be a name, like 'sac-lag', got"),
        ({"discount": Fraction(9, 10)}, "hyperparameters must be plain values: .*Fraction"),
        ({"xyzzy": 3}, "no hyper-parameter 'xyzzy': it has .*cost_limit"),
        ({"algorithm": "sac-lib"}, "unknown algorithm 'sac-lib'"),
        ({"task": "Nowhere-v0"}, "unknown task 'Nowhere-v0'"),
        ({"seeds": "ab"}, "seeds must be a tuple of one or more integers, got .'ab'"),
        (
            {"seeds": 2**41},
            "seeds must be a tuple of one or more integers, each at most 1099511627776, got",
        ),
        ({"seeds": [3, -1]}, r"seeds must be in \[0, 1099511627776\], got \(3, -1\)"),
        ({"steps": 0}, "steps must be at least 1"),
        ({"task_parameters": {"level": 3}}, "level is part of the task's id"),
        ({"vectorization": "threads"}, "vectorization must be auto or sync or async"),
        ({"backend": "fast"}, r"backend must be c\+\+ or numpy"),
        ({"step_timeout": 1e-9}, "step_timeout is for processes: .* async, got auto"),
        ({"task_parameters": [1]}, r"task_parameters must be a dict, got \[1\]"),
        ({"task_parameters": {"a": {0: 1.0}}}, "keys in task_parameters must be strings, got 0"),
        ({"task_parameters": {"a": [int]}}, "values in task_parameters must be plain, got <class"),
        ({"on_epoch": 3}, "on_epoch must be a function of an Epoch, got 3"),
        ({"out": 3}, "out must be a folder, got 3"),
        ({"task": []}, "task must be the id of a gymnasium task"),
        ({"costs": ("cost", "nothing")}, r"gives no info\['nothing'\]"),
        ({"engine": "cloud"}, "engine must be local or ray, got 'cloud'"),
        ({"engine": "ray", "on_epoch": print}, "on_epoch and progress need the engine local"),
        ({"address": "10.0.0.1:1"}, "address is of a Ray cluster"),
    ],
)
def test_mistakes_of_train(arguments, message, tmp_path, monkeypatch):
    """Nothing is written, neither to `out` nor to the current folder."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(agents.UserError, match=message):
        agents.train(**{"algorithm": "sac-lb", "steps": 50, "out": tmp_path / "x", **arguments})
    assert not list(tmp_path.iterdir())


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
