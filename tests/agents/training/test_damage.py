"""Checksums, the checkpoint before the last one, temporary files."""

import json
import os
import shutil

import numpy as np
import pytest
from small_runs import results

import agents
from agents.cli.main import main
from agents.errors import UserError
from agents.results.archive import open_source
from agents.results.reading import read_groups
from agents.training import files
from agents.training.files import read_json, unfinished, write_whole
from agents.training.loop import load_training
from agents.training.step_files import read_steps
from emcc import EpisodeRecords

OPTIONS = {"random_steps": 50, "gradient_steps": 1, "checkpoint_every": 100, "backend": "eager"}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Three checkpoints of 100 steps each."""
    out = tmp_path_factory.mktemp("damage") / "whole"
    return agents.train("sac-lag", seeds=[0, 1], steps=300, out=out, **OPTIONS).folder


@pytest.fixture
def folder(whole, tmp_path):
    return shutil.copytree(whole, tmp_path / "x")


def flip(path, at, bit=0):
    data = bytearray(path.read_bytes())
    data[at] ^= 1 << bit
    path.write_bytes(bytes(data))


def test_checksums_are_those_of_sha256(whole):
    """By the command sha256sum's own algorithm; those of steps have the header last."""
    import hashlib

    sums = json.loads((whole / "checksums.json").read_text())
    names = {f"seed-{k}/{name}" for k in (0, 1) for name in ("config.json", "episodes.csv")}
    names |= {f"seed-{k}/{name}" for k in (0, 1) for name in ("updates.csv", "evaluation.json")}
    names |= {"config.json", "checkpoint.npz", "checkpoint.previous.npz"}
    for name in names:
        assert sums.pop(name) == [hashlib.sha256((whole / name).read_bytes()).hexdigest()]
    steps = {f"seed-{k}/{name}" for k in (0, 1) for name in ("costs.npy", "visited.npy")}
    assert sums.keys() == steps
    for name in steps:
        data = (whole / name).read_bytes()
        size = data.index(b"\n") + 1
        assert sums[name] == [hashlib.sha256(data[size:] + data[:size]).hexdigest()]


@pytest.mark.parametrize("name", ["costs.npy", "visited.npy"])
@pytest.mark.parametrize("at", [20, 100, 1000, -1])
def test_a_flipped_bit_in_steps_is_named(folder, name, at):
    flip(folder / "seed-0" / name, at, 4)
    with pytest.raises(UserError, match=f"{name} is damaged"):
        read_steps(folder / "seed-0", name)
    with pytest.raises(UserError, match=f"{name} is damaged"):
        load_training(folder)


def test_steps_of_another_type(folder):
    for rows in (np.zeros((300, 3), np.float32), np.zeros((300, 2)), np.zeros(300, int)):
        np.save(folder / "seed-0" / "visited.npy", rows)
        with pytest.raises(UserError, match=r"visited\.npy is damaged: must hold float32"):
            read_steps(folder / "seed-0", "visited.npy")


def test_a_flipped_number_of_the_evaluation_is_named(folder, whole):
    path = folder / "seed-0" / "evaluation.json"
    before = path.read_text()
    path.write_text(before.replace('"J_R": -', '"J_R": '))
    [group] = read_groups(open_source(folder), [])
    assert "evaluation.json is damaged" in group.missing[0]
    agents.resume(folder)
    assert path.read_text() == before


def test_a_flipped_setting_is_named(folder, capsys):
    path = folder / "config.json"
    path.write_text(path.read_text().replace('"steps": 300', '"steps": 301'))
    for command in (["resume"], ["report"], ["evaluate", "--episodes", "2"]):
        assert main([command[0], str(folder), *command[1:]]) == 2
        assert "does not match its checksum" in capsys.readouterr().err


def test_folders_of_earlier_versions_are_read(folder, whole):
    """Without checksums, and with one checkpoint."""
    (folder / "checksums.json").unlink()
    (folder / "checkpoint.previous.npz").unlink()
    flip(folder / "seed-0" / "visited.npy", -1)
    assert len(read_steps(folder / "seed-0", "visited.npy")) == 300
    assert len(read_groups(open_source(folder), [])[0].runs) == 2
    shutil.copy(whole / "seed-0" / "visited.npy", folder / "seed-0")
    agents.resume(folder)
    assert results(folder) == results(whole)
    sums, expected = (read_json(of / "checksums.json") for of in (folder, whole))
    del expected["checkpoint.previous.npz"]
    # The checkpoint was not written again, nor were the settings.
    assert sums == {k: v for k, v in expected.items() if k in sums}
    assert "seed-1/costs.npy" in sums


@pytest.mark.parametrize("how", ["truncated", "flipped", "missing", "other"])
def test_the_checkpoint_before_takes_the_place_of_a_damaged_one(folder, whole, how):
    path = folder / "checkpoint.npz"
    if how == "missing":
        path.unlink()
    elif how == "truncated":
        path.write_bytes(path.read_bytes()[:-100])
    elif how == "flipped":
        flip(path, path.stat().st_size // 2)
    else:
        path.write_text("no checkpoint")
    with pytest.warns(UserWarning, match=r"going on from the checkpoint before it, 200 of 300"):
        assert load_training(folder).steps.tolist() == [200, 200]
    if how != "flipped":  # elsewhere than in the policy
        with pytest.warns(UserWarning, match="this is the policy of the checkpoint before it"):
            agents.load_policy(folder, seed=0)
    with pytest.warns(UserWarning, match="going on from the checkpoint before it"):
        agents.resume(folder)
    assert results(folder) == results(whole)
    assert read_json(folder / "checksums.json").keys() == read_json(whole / "checksums.json").keys()
    assert load_training(folder).steps.tolist() == [300, 300]


@pytest.mark.parametrize("error", [MemoryError, OSError])
def test_a_whole_checkpoint_that_cannot_be_read_now_is_kept(folder, whole, monkeypatch, error):
    """As where other programs take the memory meanwhile: what is damaged is another matter."""
    before, read = results(folder), files._arrays_in

    def short(file, wanted):
        if file.name.endswith("checkpoint.npz"):
            raise error
        return read(file, wanted)

    with monkeypatch.context() as patch:
        patch.setattr(files, "_arrays_in", short)
        for load in (load_training, agents.resume, lambda of: agents.load_policy(of, seed=0)):
            with pytest.raises(error):
                load(folder)
        assert results(folder) == before
        damaged = shutil.copytree(folder, folder.parent / "damaged")
        flip(damaged / "checkpoint.npz", 1000)
        with pytest.warns(UserWarning, match="going on from the checkpoint before it"):
            assert load_training(damaged).steps.tolist() == [200, 200]
        (folder / "checksums.json").unlink()  # as earlier versions left it: nobody knows
        with pytest.warns(UserWarning, match="going on from the checkpoint before it"):
            load_training(folder)
    assert load_training(folder).steps.tolist() == [300, 300]
    agents.resume(folder)
    assert results(folder) == results(whole)


def test_two_damaged_checkpoints_are_an_error(folder):
    for name in ("checkpoint.npz", "checkpoint.previous.npz"):
        flip(folder / name, 1000)
    with pytest.raises(UserError, match=r"checkpoint\.npz is damaged"):
        load_training(folder)


@pytest.mark.filterwarnings("default:.*going on from the checkpoint")
def test_the_command_says_in_one_line_that_it_falls_back(folder, capsys):
    flip(folder / "checkpoint.npz", 1000)
    assert main(["resume", str(folder)]) == 0
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("circle2d:")]
    assert len(lines) == 1
    assert "checkpoint.npz is damaged" in lines[0]


def test_every_flipped_bit_of_a_zip_directory_is_one_error(folder, tmp_path):
    """Of the end of the file, where zipfile and numpy raise errors of many kinds."""
    (folder / "checkpoint.previous.npz").unlink()
    path = folder / "checkpoint.npz"
    data = path.read_bytes()
    training = load_training(folder)
    for at in range(len(data) - 400, len(data), 7):
        flip(path, at, at % 8)
        with pytest.raises(UserError, match=r"checkpoint\.npz is damaged"):
            training.load(folder)
        path.write_bytes(data)


def test_temporary_files_follow_no_link_and_are_removed(tmp_path):
    target = tmp_path / "precious"
    target.write_text("kept")
    (tmp_path / ".x.unfinished").symlink_to(target)
    (tmp_path / ".x.0123.unfinished").write_text("left by a killed process")
    (tmp_path / ".xy.0123.unfinished").write_text("of another file")
    write_whole(tmp_path / "x", "new")
    assert target.read_text() == "kept"
    assert {path.name for path in tmp_path.iterdir()} == {
        "precious",
        "x",
        ".x.unfinished",
        ".xy.0123.unfinished",
    }
    (tmp_path / "film.gif").symlink_to(target)
    with unfinished(tmp_path / "film.gif") as temporary:
        assert temporary.suffix == ".gif"
        temporary.write_text("film")
    assert (tmp_path / "film.gif").read_text() == "film"
    assert target.read_text() == "kept"


def test_training_removes_what_killed_processes_left(folder, whole):
    left = (folder / ".status.json.01.unfinished", folder / "seed-0" / ".x.02.unfinished")
    for path in left:
        path.write_text("")
    agents.resume(folder)
    assert not any(path.exists() for path in left)
    assert results(folder) == results(whole)


def test_a_file_that_another_process_removed_is_written_again(tmp_path, monkeypatch):
    replace, calls = os.replace, []

    def once(a, b):
        calls.append(a)
        if len(calls) == 1:
            os.unlink(a)
        replace(a, b)

    monkeypatch.setattr(os, "replace", once)
    write_whole(tmp_path / "x", "new")
    assert (tmp_path / "x").read_text() == "new"
    assert len(calls) == 2
    with pytest.raises(FileNotFoundError):
        write_whole(tmp_path / "nowhere" / "x", "new")


def test_records_are_on_the_disk_before_they_have_their_name(tmp_path, monkeypatch):
    order = []
    fsync, replace = os.fsync, os.replace
    monkeypatch.setattr(os, "fsync", lambda f: (order.append("fsync"), fsync(f))[1])
    monkeypatch.setattr(os, "replace", lambda *a: (order.append("replace"), replace(*a))[1])
    columns = ([0], [0], [5], [1.0], [2.0], [2], [2], [1])
    EpisodeRecords(*map(np.array, columns)).save(tmp_path / "episodes.csv")
    assert order == ["fsync", "replace"]
