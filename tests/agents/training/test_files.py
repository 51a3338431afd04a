"""Files of runs, which are written whole or not at all; the lock of a folder; configurations."""

import builtins
import dataclasses
import errno
import io
import json
import multiprocessing
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from small_runs import TRPO, results
from toys import Walk, registered

import agents
from agents.cli.main import main
from agents.errors import UserError
from agents.presets import preset
from agents.training import files
from agents.training.config import TrainConfig, read_spaces
from agents.training.environments import Spaces
from agents.training.files import Arrays, read_json, whole, write_arrays, write_whole

TASK = "Circle2D-1-v0"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_a_full_disk_is_told_with_the_file(tmp_path):
    """The system's own error names no file, so that one could not see which disk is full."""
    with open("/dev/full", "wb", buffering=0) as full, pytest.raises(OSError) as bare:
        full.write(b"x")
    assert (bare.value.errno, bare.value.filename) == (errno.ENOSPC, None)
    words = rf"No space left on device: '{tmp_path}/runs\.npz'"
    with pytest.raises(OSError, match=words), whole(tmp_path / "runs.npz"):
        raise bare.value
    assert not [*tmp_path.iterdir()]


def test_files_are_whole_follow_no_link_and_leave_nothing(tmp_path, monkeypatch):
    target = tmp_path / "precious"
    target.write_text("kept")
    monkeypatch.setattr(files.secrets, "token_hex", lambda count: "01")
    (tmp_path / ".x.01.unfinished").symlink_to(target)
    with pytest.raises(FileExistsError):
        write_whole(tmp_path / "x", "new")
    monkeypatch.undo()
    write_whole(tmp_path / "x", "old")
    with pytest.raises(ValueError, match="in between"), files.whole(tmp_path / "x") as file:
        file.write(b"half")
        raise ValueError("in between")
    assert (tmp_path / "x").read_text() == "old"
    assert target.read_text() == "kept"
    (tmp_path / "link").symlink_to(target)
    write_whole(tmp_path / "link", "new")
    assert target.read_text() == "kept"
    assert {path.name for path in tmp_path.iterdir()} == {"precious", "x", "link"}


def test_nothing_is_unpickled(tmp_path):
    class Evil:
        def __reduce__(self):
            return (os.mkdir, (str(tmp_path / "made"),))

    with pytest.raises(ValueError, match="allow_pickle"):
        write_arrays(tmp_path / "x.npz", {"a": np.array([Evil()], dtype=object)})
    np.savez(tmp_path / "x.npz", a=np.array([Evil()], dtype=object))
    with pytest.raises(UserError, match=r"x\.npz is damaged: Object arrays"):
        _ = Arrays(tmp_path / "x.npz")["a"]
    assert not (tmp_path / "made").exists()


def test_every_flipped_bit_is_found_or_changes_nothing(tmp_path):
    arrays = {"name": np.arange(5), "other": np.array([1.5])}
    write_arrays(tmp_path / "x.npz", arrays)
    data = (tmp_path / "x.npz").read_bytes()
    for at in range(len(data)):
        changed = bytearray(data)
        changed[at] ^= 1 << at % 8
        (tmp_path / "x.npz").write_bytes(changed)
        try:
            found = dict(Arrays(tmp_path / "x.npz"))
        except UserError as error:
            assert "x.npz is damaged" in str(error)
            continue
        assert found.keys() == arrays.keys(), at
        for name, array in arrays.items():
            np.testing.assert_array_equal(found[name], array)


@pytest.mark.parametrize("number", [errno.EIO, errno.ESTALE, errno.EACCES, errno.EMFILE])
def test_an_error_that_passes_is_no_damage(tmp_path, monkeypatch, capsys, number):
    """Nothing is deleted, and the next `resume` ends as if there had been no error."""
    more = TRPO | {"seeds": 0, "steps": 400, "checkpoint_every": 100}
    agents.train("cpo", TASK, out=tmp_path / "whole", **more)
    stops = more | {"on_epoch": lambda epoch: epoch.runs[0]["step"] < 250}
    agents.train("cpo", TASK, out=tmp_path / "x", **stops)
    before = results(tmp_path / "x")
    checkpoint = max((tmp_path / "x" / "checkpoints").iterdir())
    for path in (checkpoint, max((tmp_path / "x" / "steps").iterdir()), tmp_path / "x/config.json"):
        with monkeypatch.context() as patch:
            failing_reads(patch, path, OSError(number, os.strerror(number), str(path)))
            with pytest.raises(OSError, match=os.strerror(number)):
                agents.resume(tmp_path / "x")
            assert main(["resume", str(tmp_path / "x")]) == 2
        assert results(tmp_path / "x") == before
    with monkeypatch.context() as patch:
        failing_reads(patch, checkpoint, MemoryError())
        with pytest.raises(MemoryError):
            agents.resume(tmp_path / "x")
        capsys.readouterr()
        assert main(["resume", str(tmp_path / "x")]) == 2
        assert capsys.readouterr().err.splitlines()[-1] == "circle2d: out of memory"
    agents.resume(tmp_path / "x")
    assert results(tmp_path / "x") == results(tmp_path / "whole")


def failing_reads(patch, path, error):
    """Make opening a file raise an error."""
    usual = io.open

    def opens(file, *args, **kwargs):
        if isinstance(file, (str, os.PathLike)) and os.fspath(file) == str(path):
            raise error
        return usual(file, *args, **kwargs)

    for place in (io, builtins):
        patch.setattr(place, "open", opens)


def test_a_header_that_asks_for_too_much_is_damage(tmp_path):
    """The checksum fits, so that only the size tells it apart from a lack of memory."""
    content = io.BytesIO()
    header = {"descr": "<f8", "fortran_order": False, "shape": (2**40,)}
    np.lib.format.write_array_header_1_0(content, header)
    with zipfile.ZipFile(tmp_path / "x.npz", "w") as archive:
        archive.writestr("a.npy", content.getvalue() + bytes(80))
    with pytest.raises(UserError, match=r"x\.npz is damaged: a\.npy holds 80 bytes"):
        _ = Arrays(tmp_path / "x.npz")["a"]


def test_one_file_is_open_at_a_time(tmp_path):
    """A training may leave more files than a process may open."""
    for k in range(5):
        write_arrays(tmp_path / f"{k}.npz", {"a": np.array([k]), "b": np.zeros(3)})
    handles = Path("/proc/self/fd")
    if not handles.exists():
        pytest.skip("no /proc")
    before = len(list(handles.iterdir()))
    several = [Arrays(tmp_path / f"{k}.npz") for k in range(5)]
    assert [int(arrays["a"][0]) for arrays in several] == [0, 1, 2, 3, 4]
    assert len(list(handles.iterdir())) == before


def test_damaged_json_is_named(tmp_path):
    path = tmp_path / "x.json"
    for text in ("[" * 100_000, '{"a":' * 100_000, "\x00", "12", '"x"', "true", "{", "\udcff"):
        path.write_text(text, errors="surrogateescape")
        with pytest.raises(UserError, match=r"x\.json is damaged"):
            read_json(path)
    path.unlink()
    with pytest.raises(UserError, match=r"x\.json is missing"):
        read_json(path)


HOLDER = """
import sys
if sys.argv[2] == "without":
    sys.modules["fcntl"] = None
from pathlib import Path
from agents.training.files import locked
with locked(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.readline()
"""


def hold(folder, how="with"):
    command = [sys.executable, "-W", "error", "-c", HOLDER, str(folder), how]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    process = subprocess.Popen(command, text=True, **pipes)
    return process, process.stdout.readline() == "held\n"


@pytest.mark.parametrize("how", ["with", "without"])
def test_a_lock_with_and_without_fcntl(tmp_path, how):
    """A second process is refused; a killed process holds no lock."""
    first, held = hold(tmp_path, how)
    assert held
    second, held = hold(tmp_path, how)
    assert not held
    assert f"another process is training or evaluating in {tmp_path}" in second.communicate()[1]
    first.kill()
    first.communicate()
    third, held = hold(tmp_path, how)
    assert held
    assert third.communicate("done\n") == ("", "")


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.EOPNOTSUPP])
def test_a_file_system_without_locks_is_refused(tmp_path, monkeypatch, number):
    def fails(*args):
        raise OSError(number, os.strerror(number))

    fcntl = pytest.importorskip("fcntl")
    monkeypatch.setattr(fcntl, "flock", fails)
    with pytest.raises(UserError, match=r"x/\.lock cannot be locked.* NFS.*local disk"):
        agents.train("cpo", TASK, out=tmp_path / "x", **TRPO | {"seeds": 0, "steps": 50})
    assert not list(tmp_path.iterdir())


def test_a_task_that_changes_the_current_folder(tmp_path, monkeypatch):
    """Relative paths of folders keep referring to the folder of the command."""
    (tmp_path / "other").mkdir()

    class Elsewhere(Walk):
        def __init__(self):
            super().__init__()
            os.chdir(tmp_path / "other")

    monkeypatch.chdir(tmp_path)
    more = ["--seeds", "0", "--steps", "50", "--backend", "numpy", "--hidden", "8"]
    with registered(Elsewhere=Elsewhere):
        assert main(["train", "cpo", "--task", "Elsewhere-v0", "--out", "x", *more]) == 0
        for command in (["resume", "x"], ["evaluate", "x", "--episodes", "1"]):
            os.chdir(tmp_path)
            assert main(command) == 0
    assert {path.name for path in tmp_path.iterdir()} == {"x", "other"}
    assert not list((tmp_path / "other").iterdir())


def test_a_folder_that_is_being_trained_is_said_to_be(tmp_path):
    """Where a second process would resume it. A folder that holds runs already says how to resume
    them. Neither is changed."""
    more = TRPO | {"seeds": 0, "steps": 50, "out": tmp_path / "x"}
    agents.train("cpo", TASK, **more)
    before = results(tmp_path / "x")
    process, held = hold(tmp_path / "x")
    assert held
    with pytest.raises(UserError, match="another process is training or evaluating in"):
        agents.resume(tmp_path / "x")
    process.communicate("done\n")
    with pytest.raises(UserError, match=r"holds runs already.*circle2d resume .*agents\.resume"):
        agents.train("trpo-lag", TASK, **more)
    assert results(tmp_path / "x") == before


def config(task=TASK, seeds=(0,), **changes):
    return TrainConfig("cpo", (task,), seeds, 100, preset("cpo", TASK), **changes)


def edit(folder, **changes):
    path = folder / "config.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))


def test_a_configuration_is_read_as_it_was_written(tmp_path):
    several = dataclasses.replace(config(), tasks=(TASK, "Circle2D-2-v0"), seeds=(3, 1))
    more = {"snapshots": config(evaluate_every=50), "timeout": config(step_timeout=2.0)}
    more |= {"several": several, "costs": config(costs=("cost", "cost_2"))}
    for name, one in ({"plain": config()} | more).items():
        one.write(tmp_path / name)
        assert TrainConfig.read(tmp_path / name) == one
        assert TrainConfig.read(tmp_path / name, strict=False) == one


def test_hyperparameters_newer_than_the_runs(tmp_path):
    """They have the values that mean "off", not SAC-LB-Streak's present defaults."""
    chosen = preset("sac-lb-streak", TASK)
    TrainConfig("sac-lb-streak", (TASK,), (0,), 100, chosen).write(tmp_path)
    values = read_json(tmp_path / "config.json")["hyperparameters"]
    for name in ("novelty_bonus", "random_share", "streak_weight", "novelty_length"):
        del values[name]
    edit(tmp_path, hyperparameters=values)
    off = {"novelty_bonus": 0.0, "random_share": 0.0, "streak_weight": 0.0}
    assert TrainConfig.read(tmp_path).hyperparameters == dataclasses.replace(chosen, **off)


def test_a_configuration_of_an_algorithm_that_is_not_registered(tmp_path):
    config().write(tmp_path)
    values = {"cost_limit": 5.0, "hidden": [8, 9], "my_factor": 0.25}
    edit(tmp_path, algorithm="mine", modules=["my_module"], hyperparameters=values)
    with pytest.raises(UserError, match=r"'mine' of .* is not registered here: import my_module"):
        TrainConfig.read(tmp_path)
    read = TrainConfig.read(tmp_path, strict=False)
    assert dataclasses.asdict(read.hyperparameters) == {**values, "hidden": (8, 9)}
    assert read.settings["hyperparameters.my_factor"] == 0.25
    assert "my_module" not in sys.modules
    edit(tmp_path, modules=["__main__"])
    with pytest.raises(UserError, match="register it in a module, not in a script"):
        TrainConfig.read(tmp_path)
    edit(tmp_path, modules=[])
    with pytest.raises(UserError, match="unknown algorithm 'mine': valid are trpo-lag, "):
        TrainConfig.read(tmp_path)


POSSIBLE = (("task_parameters", {"a": 1}), ("tensorboard", True))
OTHER = (None, 7.5, [], [[1]], {"a": 1}, "-x", 10**400, -1, True)


@pytest.mark.parametrize("strict", [True, False])
def test_settings_of_another_type_are_damage(tmp_path, strict):
    config(evaluate_every=50, step_timeout=1.0).write(tmp_path)
    path = tmp_path / "config.json"
    content = json.loads(path.read_text())
    nullable = ("evaluate_every", "step_timeout")
    fine = [*POSSIBLE, ("step_timeout", 7.5), *((name, None) for name in nullable)]
    for name in content.keys() - {"versions", "machine", "commit", "spaces", "modules"}:
        for value in OTHER:
            if (name, value) in fine:
                continue
            path.write_text(json.dumps(content | {name: value}))
            with pytest.raises(UserError):
                TrainConfig.read(tmp_path, strict)
    edit(tmp_path, **content)
    for changes in ({"seeds": [0, 0]}, {"seeds": [2**63]}, {"nonsense": 1}, {"tasks": "Walk-v0"}):
        edit(tmp_path, **content | changes)
        with pytest.raises(UserError):
            TrainConfig.read(tmp_path, strict)
    edit(tmp_path, **content | {"task": "Walk-v0"})
    with pytest.raises(UserError, match=r"is of version 0\.2"):
        TrainConfig.read(tmp_path, strict)


def test_the_spaces_of_a_configuration_are_read_and_checked(tmp_path):
    config("Walk-v0").write(tmp_path)
    expected = Spaces(2, (-2.0,), (2.0,), "float32")
    assert read_spaces(tmp_path) == expected
    bounds = expected._asdict()
    for wrong in ({}, 3, bounds | {"low": [3.0]}, bounds | {"high": [1, 2]}):
        edit(tmp_path, spaces=wrong)
        with pytest.raises(UserError, match=r"config\.json is damaged: spaces"):
            read_spaces(tmp_path)


def test_of_two_processes_that_make_one_folder_at_once_one_is_refused(tmp_path):
    """The other's configuration is whole."""
    fork, folder = multiprocessing.get_context("fork"), tmp_path / "x"
    both = fork.Barrier(2)

    def write(seeds):
        both.wait()
        try:
            config(seeds=seeds).write(folder)
        except UserError:
            sys.exit(2)

    writers = {seeds: fork.Process(target=write, args=(seeds,)) for seeds in ((0, 1), (5, 6))}
    for writer in writers.values():
        writer.start()
    for writer in writers.values():
        writer.join(60)
    assert sorted(writer.exitcode for writer in writers.values()) == [0, 2]
    [made] = [seeds for seeds, writer in writers.items() if not writer.exitcode]
    assert TrainConfig.read(folder).seeds == made
