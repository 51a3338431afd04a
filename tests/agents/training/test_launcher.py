"""Several trainings at a time, in processes or on Ray, and the transfer of their files from Ray."""

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from small_runs import TRPO, processes, results, wait_until

import agents
from agents.api import configs_of
from agents.errors import UserError
from agents.training import launcher as module
from agents.training.launcher import Launcher, launcher, new_files, take_in
from agents.training.trainer import train


def made(folder, steps=200):
    own = {"seeds": (0, 1), "steps": steps, "checkpoint_every": 100}
    hyperparameters = {name: value for name, value in TRPO.items() if name != "backend"}
    [config] = configs_of("trpo-lag", "Circle2D-1-v0", [hyperparameters], "paper", "numpy", own)
    config.write(folder)
    return folder


def test_as_many_run_at_a_time_as_asked_for_and_one_that_fails_stops_no_other():
    going, most, done = set(), [], []
    steps = threading.Barrier(2, timeout=60)

    def work(folder, ending):
        going.add(folder)
        most.append(len(going))
        steps.wait()
        going.discard(folder)
        steps.wait()
        done.append(folder.name)
        if folder.name == "1":
            raise UserError("its words")
        return "no luck" if folder.name == "2" else ""

    changes = []
    with Launcher(2, work) as trainings:
        for k in range(6):
            trainings.submit(Path(str(k)))
        trainings.wait(lambda: changes.append(1), every=0.01)
        assert trainings.failed == {Path("1"): "its words", Path("2"): "no luck"}
        assert trainings.running == []
    assert max(most) == 2
    assert sorted(done) == list("012345")
    assert changes


def test_a_folder_that_cannot_be_written_stops_no_other(tmp_path):
    """A full disk or another user's folder stops one training: the others are trained."""
    for name in "abc":
        made(tmp_path / name)
    (tmp_path / "b" / "worker.log").mkdir()
    with launcher(count=1) as trainings:
        for name in "abc":
            trainings.submit(tmp_path / name)
        trainings.wait(lambda: trainings.failed, every=0.01)
        [(folder, why)] = trainings.failed.items()
    assert folder == tmp_path / "b"
    assert "worker.log" in why
    assert (tmp_path / "a" / "results.npz").is_file()
    assert (tmp_path / "c" / "results.npz").is_file()


def test_a_process_that_ends_before_its_training_is_no_success(tmp_path, monkeypatch):
    """Even with status 0, as after `sys.exit` in a user's code."""
    folder = made(tmp_path / "x")

    def ends(folder, imports):
        return subprocess.Popen([sys.executable, "-c", ""], stdin=subprocess.PIPE)

    monkeypatch.setattr(module, "start", ends)
    with launcher(count=1) as trainings:
        trainings.submit(folder)
        trainings.wait(every=0.05)
        assert "ended before the training did" in trainings.failed[folder]


def test_leaving_the_launcher_ends_what_runs_and_starts_no_other():
    started = []

    def work(folder, ending):
        started.append(folder.name)
        assert ending.wait(60)
        return ""

    with Launcher(1, work) as trainings:
        trainings.submit(Path("a"))
        trainings.submit(Path("b"))
        wait_until(lambda: started)
    assert started == ["a"]


def test_processes_train_folders_and_leaving_writes_checkpoints(tmp_path):
    """test_sweeps.py has a process that fails."""
    short, long = made(tmp_path / "a"), made(tmp_path / "b", 10**7)
    with launcher(count=1) as trainings:
        for folder in (short, long):
            trainings.submit(folder)
        wait_until(lambda: trainings.jobs[short].done())
        wait_until(lambda: (long / "status.json").exists())
        assert trainings.running == [long]
        assert not trainings.failed
    assert (long / "checkpoints").exists()
    assert not (long / "results.npz").exists()
    assert agents.load_policy(long, seed=1).step > 0
    train(made(tmp_path / "alone"))
    ours, theirs = results(short), results(tmp_path / "alone")
    # Evaluations in this process have fewer episodes.
    assert ours.pop("results.npz") and theirs.pop("results.npz")
    assert ours == theirs


PARENT = """
import sys
from pathlib import Path
from agents.training.launcher import launcher
with launcher(count=1) as trainings:
    trainings.submit(Path(sys.argv[1]))
    trainings.wait()
"""


def test_processes_end_with_a_parent_that_is_killed(tmp_path):
    """They leave a checkpoint."""
    folder = made(tmp_path / "x", 10**7)
    parent = subprocess.Popen([sys.executable, "-c", PARENT, str(folder)])
    wait_until(lambda: (folder / "status.json").exists())
    assert processes(folder)
    os.kill(parent.pid, signal.SIGKILL)
    parent.wait()
    wait_until(lambda: not processes(folder), 60)
    assert agents.load_policy(folder, seed=0).step > 0


def test_a_transfer_of_files_may_be_interrupted_at_any_moment(tmp_path, monkeypatch):
    """After every prefix of the written files the training is resumed to the same results."""
    there = made(tmp_path / "there", 400)
    expected = results(train(made(tmp_path / "whole", 400)).folder)
    train(there, lambda trainer: trainer.epochs.max() < 1)
    known, files = {"status.json"}, {}
    first, names = new_files(there, known, last=False)
    assert {name for name in first if "/" in name} == {
        *("checkpoints/000000100.npz", "steps/000000100.npz")
    }
    assert {"config.json", "status.json"} <= first.keys()
    assert new_files(there, known, last=False) == ({}, names)
    here = tmp_path / "here"
    take_in(here, first, names)
    assert {name: (here / name).read_bytes() for name in first} == dict(first)
    train(there, lambda trainer: trainer.epochs.max() < 3)
    (there / ".steps.npz.01.unfinished").write_text("half")
    second, names = new_files(there, known, last=False)
    assert "status.json" in second
    assert not any("unfinished" in name for name in names)
    assert not {"config.json", "steps/000000100.npz"} & second.keys()
    written, write = [], module.write_whole

    def count(path, content):
        if len(written) == stop:
            raise KeyboardInterrupt
        written.append(path)
        write(path, content)

    monkeypatch.setattr(module, "write_whole", count)
    for stop in range(len(second) + 1):
        written.clear()
        folder = tmp_path / f"cut{stop}"
        for name, content in first.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)
        try:
            take_in(folder, second, names)
            assert stop == len(second)
            there_now = {p.name for p in (there / "checkpoints").iterdir()}
            assert {p.name for p in (folder / "checkpoints").iterdir()} == there_now
        except KeyboardInterrupt:
            pass
        files[stop] = results(train(folder).folder)
    assert set(map(str, files.values())) == {str(expected)}


@pytest.mark.slow
def test_a_training_survives_the_loss_of_its_ray_node(tmp_path, monkeypatch):
    """Another node resumes it from the newest checkpoint that was sent."""
    pytest.importorskip("ray")
    from ray_nodes import nodes

    folder = made(tmp_path / "x", 20_000)
    expected = train(made(tmp_path / "whole", 20_000)).folder
    with (
        nodes(2, tmp_path / "nodes", monkeypatch) as (address, lose),
        launcher("ray", 1, address=address) as trainings,
    ):
        trainings.submit(folder)
        wait_until(lambda: len(list((folder / "checkpoints").glob("*.npz"))) > 1)
        next(end for where, end in lose.items() if any(where.rglob("config.json")))()
        trainings.wait()
        assert not trainings.failed
    ours, theirs = results(folder), results(expected)
    newest = next(name for name in theirs if name.startswith("checkpoints"))
    assert ours[newest] == theirs[newest]
