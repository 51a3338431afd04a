"""The entrance from Python: the same runs as the command's, and nothing left changed."""

import dataclasses
import doctest
import gc
import re
import shutil
import signal
import subprocess
import sys

import numpy as np
import pytest
import torch
from small_runs import results, write_evaluated
from toys import register as register_toys

import agents
from agents import api
from agents.cli.main import main
from agents.paper.presets import preset
from agents.training.config import TrainConfig
from emcc import EpisodeRecords

register_toys()
SMALL = {"random_steps": 100, "gradient_steps": 2}


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    out = tmp_path_factory.mktemp("api") / "runs"
    return agents.train("sac-lag", seeds=[3, 4], steps=400, out=out, **SMALL)


def test_importing_agents_imports_no_torch():
    code = "import sys, agents; agents.UserError; agents.__all__; dir(agents)\n"
    code += "assert 'torch' not in sys.modules and 'numpy' not in sys.modules, 'imported'\n"
    code += "agents.register; assert 'torch' not in sys.modules, 'by register'"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_names():
    assert set(agents.__all__) <= set(dir(agents))
    for name in agents.__all__:
        assert getattr(agents, name) is getattr(api, name)
        assert getattr(agents, name).__doc__
    with pytest.raises(AttributeError, match="no attribute 'teach'"):
        _ = agents.teach


def test_examples():
    outcome = doctest.testmod(api, raise_on_error=True)
    assert outcome.attempted >= 9


def test_the_runs_are_those_of_the_command(runs, tmp_path, capsys):
    options = ["--random-steps", "100", "--gradient-steps", "2", "--seeds", "3", "4"]
    command = ["train", "--algorithm", "sac-lag", *options, "--steps", "400"]
    assert main([*command, "--out", str(tmp_path / "x")]) == 0
    assert results(tmp_path / "x") == results(runs.folder)
    assert runs.table() in capsys.readouterr().out


def test_results(runs):
    [group] = runs.results
    assert [run.seed for run in group.runs] == [3, 4]
    assert runs.config == TrainConfig.read(runs.folder)
    records = runs.records[runs.folder, 3]
    assert records.total_steps == 400
    assert repr(runs) == f"Runs({str(runs.folder)!r})"


def test_report(runs, tmp_path):
    shutil.copytree(runs.folder, tmp_path / "x")
    assert agents.report(tmp_path).startswith(runs.table()[:80])
    assert (tmp_path / "index.html").exists()


def test_compare(runs, tmp_path):
    tables = agents.compare(runs.folder, str(runs.folder), out=tmp_path)
    assert re.search(r"^\| B - A: .*? \| \+?0\.00 ", tables, re.MULTILINE)
    assert (tmp_path / "compare.md").read_text() == tables


def test_runs_stand_for_their_folder(runs, tmp_path):
    assert agents.load_policy(runs, seed=3).seed == 3
    assert agents.evaluate(runs, episodes=1).costs.shape == (2, 1)
    assert agents.load_runs(runs).folders == runs.folders
    assert agents.report(runs, out=tmp_path) == agents.report(runs.folder, out=tmp_path)
    assert agents.compare(runs, runs) == agents.compare(runs.folder, runs.folder)
    assert agents.resume(runs).folder == runs.folder
    copy = shutil.copytree(runs.folder, tmp_path / "copy")
    both = agents.load_runs(runs, copy)
    assert agents.report(both, out=tmp_path) == agents.report(runs.folder, copy, out=tmp_path)
    with pytest.raises(ValueError, match="there are several folders"):
        agents.load_policy(both)
    with pytest.raises(agents.UserError, match="would count twice"):
        agents.report(runs, runs.folder, out=tmp_path)


def test_to_pandas(runs, monkeypatch):
    pytest.importorskip("pandas")
    frame = runs.to_pandas()
    assert list(frame.columns[:8]) == [
        *("folder", "algorithm", "task", "seed", "rollout", "start_step", "length", "return"),
    ]
    assert set(frame.folder) == {runs.folder.name}
    of_seed = frame[frame.seed == 4]
    np.testing.assert_array_equal(of_seed["cost"], runs.records[runs.folder, 4].cost)
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match="pip install pandas"):
        runs.to_pandas()


def test_folders_that_differ_in_a_setting_are_told_apart(tmp_path):
    """Of each folder as many cost steps in every episode, of ten, as written here."""
    pytest.importorskip("pandas")
    costs = {(32, 32): (1, 2), (64,): (3, 4)}
    for hidden, of_seeds in costs.items():
        changed = dataclasses.replace(preset("sac-lag", "Circle2D-1-v0"), hidden=hidden)
        write_evaluated(tmp_path / "nets" / str(len(hidden)), "sac-lag", of_seeds, changed)
    write_evaluated(tmp_path / "nets" / "1" / "inner", "sac-lag", (9,))
    runs = agents.Runs([tmp_path / "nets" / "2", tmp_path / "nets" / "1"])
    assert [group.folder for group in runs.results] == ["2", "1"]
    frame = runs.to_pandas()
    assert list(frame.columns[:5]) == ["folder", "algorithm", "task", "hidden", "seed"]
    of_groups = frame.groupby(["hidden", "seed"]).cost.mean().to_dict()
    expected = {(k, seed): of[seed] for k, of in costs.items() for seed in (0, 1)}
    assert of_groups == expected
    frame = runs.to_pandas("runs")
    assert list(frame.columns[:6]) == [
        *("folder", "algorithm", "task", "hidden", "seed", "EMCC_0.33"),
    ]
    assert frame.folder.tolist() == ["2", "2", "1", "1"]
    assert frame.cost_rate.tolist() == [0.1, 0.2, 0.3, 0.4]
    assert frame["EMCC_0.99"].tolist() == pytest.approx([0.1, 0.2, 0.3, 0.4])
    with pytest.raises(agents.UserError, match="rows must be episodes or runs, got 'measures'"):
        runs.to_pandas("measures")


def test_finished_runs_are_opened_again(runs, tmp_path):
    """By a string, or from a folder above; without the module of an algorithm of one's own."""
    shutil.copytree(runs.folder, tmp_path / "a" / "x")
    shutil.copytree(runs.folder, tmp_path / "a" / "y")
    before = results(tmp_path)
    again = agents.load_runs(str(tmp_path / "a"))
    assert again.folders == (tmp_path / "a" / "x", tmp_path / "a" / "y")
    one = agents.load_runs(str(again.folders[0]), again.folders[0])
    assert (one.config, one.folder) == (runs.config, again.folders[0])
    assert one.results[0].runs[0].measures == runs.results[0].runs[0].measures
    path = again.folders[1] / "config.json"
    path.write_text(path.read_text().replace('"sac-lag"', '"sac-own"'))
    (path.parent / "checksums.json").unlink(missing_ok=True)
    own = agents.load_runs(path.parent)
    assert own.config.algorithm == "sac-own"
    assert own.config.hyperparameters.random_steps == 100
    assert len(own.records) == 2
    path.write_text("{")
    for folders, message in {
        (): "needs a folder",
        (tmp_path / "no",): "no is no folder",
        (tmp_path / "a" / "x" / "seed-3",): "seed-3 holds no runs",
        (tmp_path,): "config.json",
    }.items():
        with pytest.raises(agents.UserError, match=message):
            agents.load_runs(*folders)
    with pytest.raises(
        agents.UserError, match="takes a list of folders, got 'runs': see load_runs"
    ):
        agents.Runs("runs")
    path.unlink()
    assert results(tmp_path / "a" / "x") == {
        name.removeprefix("a/x/"): of for name, of in before.items() if name.startswith("a/x/")
    }


def test_a_temporary_folder_lives_as_long_as_the_runs():
    runs = agents.train("trpo-lag", seeds=5, steps=50)
    folder = runs.folder
    assert runs.config.seeds == (5,)
    assert (folder / "seed-5" / "evaluation.json").exists()
    del runs
    gc.collect()
    assert not folder.exists()


def test_epochs_are_plain_numbers_by_seed(tmp_path):
    epochs = []
    runs = agents.train(
        "sac-lb", seeds=[0, 1], steps=200, out=tmp_path / "x", on_epoch=epochs.append, **SMALL
    )
    assert [epoch.runs[1]["step"] for epoch in epochs] == [50, 100, 150, 200]
    records = runs.records[runs.folder, 1]
    for k, epoch in enumerate(epochs):
        numbers = epoch.runs[1]
        assert (epoch.folder, epoch.algorithm, epoch.steps) == (tmp_path / "x", "sac-lb", 200)
        assert all(type(value) is float for value in numbers.values())
        assert numbers["return"] == records.reward[k]
        assert numbers["cost"] == records.cost[k]
        assert numbers["mcc"] == records.longest_streak[k] / 50
    assert "critic_loss" not in epochs[0].runs[0]  # less than a batch is there


def test_stopped_and_resumed_is_as_never_stopped(runs, tmp_path):
    seen = []

    def stop(epoch):
        seen.append(epoch)
        return np.bool_(len(seen) < 3)

    stopped = agents.train(
        "sac-lag", seeds=[3, 4], steps=400, out=tmp_path / "x", on_epoch=stop, **SMALL
    )
    assert len(seen) == 3
    records = EpisodeRecords.load(stopped.folder / "seed-3" / "episodes.csv")
    assert records.total_steps == 150
    with pytest.raises(agents.UserError, match="unfinished"):
        _ = stopped.results
    assert agents.evaluate(stopped.folder, episodes=1).returns.shape == (2, 1)
    resumed = agents.resume(stopped.folder, on_epoch=seen.append)
    assert seen[3].runs[3]["step"] == 200
    assert results(resumed.folder) == results(runs.folder)


def test_several_folders_resume_jointly(tmp_path):
    folders = [tmp_path / "a", tmp_path / "b"]
    for level, folder in enumerate(folders):
        task = f"Circle2D-{level}-v0"
        out = {"out": folder, "on_epoch": lambda epoch: False}
        agents.train("trpo-lag", task, seeds=level, steps=600, episodes=4, **out)
    epochs = []
    runs = agents.resume(*folders, folders[0], on_epoch=epochs.append)
    assert runs.folders == tuple(folders)
    assert [epoch.folder.name for epoch in epochs] == ["a", "b", "a", "b"]
    assert {folder.name: seed for folder, seed in runs.records} == {"a": 0, "b": 1}
    with pytest.raises(ValueError, match="several folders"):
        _ = runs.folder
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
def test_a_guest_in_the_process(tmp_path, raises):
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
            agents.train("cpo", seeds=0, steps=50, out=tmp_path / "x", on_epoch=fail)
        assert state_of_process() == before
    finally:
        torch.set_num_threads(threads)
        if precision is not None:
            matmul.fp32_precision = precision
    assert during == [1]


def test_a_folder_with_runs_is_refused(runs):
    before = results(runs.folder)
    with pytest.raises(agents.UserError, match="holds runs already"):
        agents.train("cpo", out=runs.folder)
    assert results(runs.folder) == before
    with pytest.raises(agents.UserError, match="needs a folder"):
        agents.resume()
    with pytest.raises(agents.UserError, match=r"folders one by one, .* got \['a', 'b'\]"):
        agents.resume(["a", "b"])
