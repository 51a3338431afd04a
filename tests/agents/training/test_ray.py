"""The grid on Ray, on clusters of this machine whose nodes have working folders of their own."""

import dataclasses
import os
import signal
import subprocess
import sys
import time

import pytest
from ray_nodes import descendants, nodes, processes, runs, wait_until
from toys import register

import agents
from agents.cli.main import main
from agents.errors import UserError
from agents.paper import grid
from agents.training.config import TrainConfig
from agents.training.engines import engine
from agents.training.loop import train
from agents.training.status import share_done

register()


def small_grid(out, algorithms=("trpo-lag",), seeds=(3,), steps=2000, every=500):
    """Folders of a grid, prepared."""
    configs = grid.grid(out, ["Circle2D-1-v0"], algorithms, seeds, steps)
    configs = {f: dataclasses.replace(c, checkpoint_every=every) for f, c in configs.items()}
    grid.prepare(configs)
    return configs


def results(folder):
    """Bytes of all files but timings and logs; reports draw with the folder's name."""
    left_out = ("status.json", "worker.log", "index.html", ".lock", "report.md")
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name not in left_out and "pictures" not in path.parts
    }


def train_on(address, configs, on_change=lambda: None, imports=()):
    """Train folders, a group each."""
    with (
        engine("ray", address=address) as ready,
        ready.workers(
            [(folder,) for folder in configs], lambda f: grid.finished(f, configs[f]), imports
        ) as workers,
    ):  # fmt: skip
        workers.run(on_change, 0.2)
        assert workers.failed == {}


def reproduce(out, *options):
    return main(["reproduce", "--quick", "--out", str(out), *options])


@pytest.mark.slow
def test_an_address_where_nothing_is(tmp_path, capsys):
    """Refused in seconds, before anything is written."""
    pytest.importorskip("ray")
    for address, message in (
        ("127.0.0.1:9", "no Ray cluster answers at 127.0.0.1:9: "),
        ("nowhere", "address must be HOST:PORT or auto, got 'nowhere'"),
    ):
        started = time.monotonic()
        assert reproduce(tmp_path / "x", "--engine", "ray", "--address", address) == 2
        assert message in capsys.readouterr().err
        assert time.monotonic() - started < 60
        with pytest.raises(UserError, match=message):
            agents.train("cpo", steps=1000, out=tmp_path / "x", engine="ray", address=address)
        assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_the_same_report(tmp_path):
    """Two levels of the quick grid, with fewer steps: byte for byte that of the local engine; no
    process of Ray is left."""
    pytest.importorskip("ray")
    for name in ("local", "ray"):
        options = ["--levels", "0", "1", "--steps", "1500", "--engine", name]
        assert reproduce(tmp_path / name / "grid", *options) == 0
    of_both = [tmp_path / name / "grid" for name in ("local", "ray")]
    local, ray = ((out / "report.csv").read_bytes() for out in of_both)
    assert local == ray
    assert results(of_both[0]) == results(of_both[1])
    # The folder of Ray's session ends with the id of the process that started it.
    wait_until(lambda: not processes(f"_{os.getpid()}/"))


@pytest.mark.slow
@pytest.mark.parametrize("when", ["running", "stopped"])
def test_a_node_that_is_killed(tmp_path, monkeypatch, when):
    """The group goes on from its last checkpoint on the other node, to the same results."""
    pytest.importorskip("ray")
    configs = small_grid(tmp_path / "ray", steps=4000)
    (folder,) = configs
    killed = []

    def kill_the_busy_node():
        if killed or not (folder / "checkpoint.npz").exists() or share_done(folder) > 0.9:
            return
        (busy,) = (at for at in lose if processes(at))
        if when == "stopped":  # wherever it is, be it in the middle of a file
            for process in processes(busy):
                os.kill(process, signal.SIGSTOP)
        lose[busy]()
        killed.append(busy)

    with nodes(2, tmp_path / "nodes", monkeypatch) as (address, lose):
        train_on(address, configs, kill_the_busy_node)
    assert killed
    assert_as_trained_alone(folder, tmp_path / "alone")


HALTS = """
import os, pathlib, signal

move, told = os.replace, pathlib.Path(__file__).parent

def move_or_halt(source, target):
    target = pathlib.Path(target)
    checkpoint, previous = (target.with_name(f"checkpoint{word}.npz") for word in ("", ".previous"))
    at = {previous: "before", checkpoint: "between"}.get(target)
    if at == "before" or (at == "between" and previous.exists() and not checkpoint.exists()):
        if not (told / at).exists():
            (told / at).write_text(str(target))
            os.kill(os.getpid(), signal.SIGSTOP)
    move(source, target)

os.replace = move_or_halt
"""
"""Halts the first training that has written the records of its second checkpoint, and not moved
that into place; and the first that has moved the old one away, and not put the new one there."""


@pytest.mark.slow
def test_nodes_that_are_killed_in_the_middle_of_a_checkpoint(tmp_path, monkeypatch):
    """Two of three, one after the other: the third comes to the same results."""
    pytest.importorskip("ray")
    (tmp_path / "halts.py").write_text(HALTS)
    path = os.pathsep.join(filter(None, (str(tmp_path), os.environ.get("PYTHONPATH"))))
    configs = small_grid(tmp_path / "ray", steps=3000)
    (folder,) = configs
    killed = {}

    def kill_what_halts():
        for when in ("before", "between"):
            told = tmp_path / when
            # For three seconds, so that the node may send what is there.
            if when in killed or not told.exists() or time.time() - told.stat().st_mtime < 3:
                continue
            (killed[when],) = (at for at in lose if str(at) in told.read_text())
            lose[killed[when]]()

    with nodes(3, tmp_path / "nodes", monkeypatch, {"PYTHONPATH": path}) as (address, lose):
        train_on(address, configs, kill_what_halts, ["halts"])
    assert len(set(killed.values())) == 2
    for at in lose:  # what was killed left its files, what ended did not
        assert bool(list(at.glob("circle2d-*"))) == (at in killed.values())
    assert_as_trained_alone(folder, tmp_path / "alone")


@pytest.mark.slow
def test_three_nodes_with_folders_of_their_own(tmp_path, monkeypatch):
    """A group each; nothing of them is left there."""
    pytest.importorskip("ray")
    configs = {}
    for seed in (3, 4, 5):
        configs |= small_grid(tmp_path / f"ray-{seed}", seeds=(seed,))
    seen = set()

    def look():
        seen.update(at for at in lose if list(at.glob("circle2d-*/0/trpo-lag")))

    with nodes(3, tmp_path / "nodes", monkeypatch) as (address, lose):
        train_on(address, configs, look)
        assert seen == set(lose)
        wait_until(lambda: not any(list(at.glob("circle2d-*")) for at in lose))
    for folder in configs:
        assert_as_trained_alone(folder, tmp_path / "alone" / folder.parents[1].name)


def assert_as_trained_alone(folder, out):
    config = TrainConfig.read(folder)
    (alone,) = small_grid(out, seeds=config.seeds, steps=config.steps)
    train(alone)
    for seed in config.seeds:
        for name in ("episodes.csv", "updates.csv", "costs.npy", "visited.npy", "evaluation.json"):
            of_both = [of / f"seed-{seed}" / name for of in (folder, alone)]
            assert of_both[0].read_bytes() == of_both[1].read_bytes(), name


@pytest.mark.slow
def test_a_driver_that_ends_between_the_files_of_a_checkpoint(tmp_path, monkeypatch):
    """Given again, the training goes on to the same results."""
    pytest.importorskip("ray")
    from agents.training import transfer

    configs = small_grid(tmp_path / "ray", steps=4000)
    (folder,) = configs
    written, write_whole = [], transfer.write_whole

    def write_some(path, content):
        if any(path.name == "checkpoint.npz" for path in written):
            raise KeyboardInterrupt
        write_whole(path, content)
        written.append(path)

    with monkeypatch.context() as patch:
        patch.setattr(transfer, "write_whole", write_some)
        with pytest.raises(KeyboardInterrupt):
            train_on(None, configs)
    assert not grid.finished(folder, configs[folder])
    train_on(None, configs)
    assert_as_trained_alone(folder, tmp_path / "alone")


DRIVER = """
import dataclasses, sys
from agents.paper import grid

whole = grid.grid

def with_more_checkpoints(*args):
    return {f: dataclasses.replace(c, checkpoint_every=500) for f, c in whole(*args).items()}

grid.grid = with_more_checkpoints
from agents.cli.main import main
sys.exit(main())
"""


@pytest.mark.slow
def test_a_driver_that_is_killed(tmp_path):
    """All that it had started ends; the same command goes on to the same results."""
    pytest.importorskip("ray")
    folder = tmp_path / "ray" / "Circle2D-1-v0" / "trpo-lag"
    command = [sys.executable, "-c", DRIVER, "reproduce", "--out", str(tmp_path / "ray")]
    command += ["--levels", "1", "--algorithms", "trpo-lag", "--seeds", "3", "--steps", "10000"]
    command += ["--backend", "eager", "--engine", "ray", "--shard", "1/1"]
    with subprocess.Popen(command) as process:
        try:
            wait_until(lambda: (folder / "checkpoint.npz").exists() or process.poll() is not None)
            started = descendants(process.pid)
            assert started & processes("raylet")
            assert started & processes("/circle2d-")  # what trains
        finally:
            process.kill()
    wait_until(lambda: not any(map(runs, started)))
    assert not grid.finished(folder, TrainConfig.read(folder))
    assert subprocess.run(command, check=False).returncode == 0
    assert_as_trained_alone(folder, tmp_path / "alone")
