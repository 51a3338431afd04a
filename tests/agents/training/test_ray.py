"""The grid on Ray, on clusters of this machine whose nodes have working folders of their own."""

import contextlib
import dataclasses
import os
import shutil
import signal
import sys
import time
from pathlib import Path

import pytest
from toys import register

import agents
from agents.cli.main import main
from agents.errors import UserError
from agents.paper import grid
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


def ray_processes():
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            text = path.read_bytes().replace(b"\0", b" ")
            if b"raylet" in text or b"gcs_server" in text:
                found.append(path.parent.name)
    return set(found)


def reproduce(out, *options):
    return main(["reproduce", "--quick", "--out", str(out), *options])


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


def test_without_ray(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    assert reproduce(tmp_path / "x", "--engine", "ray") == 2
    assert "needs ray, which is not installed: pip install" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_the_address_is_rays(tmp_path, capsys):
    assert reproduce(tmp_path / "x", "--address", "auto") == 2
    assert "address is of the engine ray" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("given", ["0/2", "3/2", "1", "a/b", "1/2/3"])
def test_shards_that_there_are_not(tmp_path, capsys, given):
    assert reproduce(tmp_path / "x", "--shard", given) == 2
    assert f"shard must be I/N with I from 1 to N, such as 1/4, got '{given}'" in (
        capsys.readouterr().err
    )
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_the_same_report(tmp_path):
    """Byte for byte that of the local engine; no process of Ray is left."""
    pytest.importorskip("ray")
    before = ray_processes()
    options = ["--quick", "--levels", "1", "--algorithms", "trpo-lag", "cpo", "--steps", "2000"]
    for name in ("local", "ray"):
        out = tmp_path / name / "grid"
        assert main(["reproduce", *options, "--out", str(out), "--engine", name]) == 0
    assert results(tmp_path / "local" / "grid") == results(tmp_path / "ray" / "grid")
    until = time.monotonic() + 30
    while ray_processes() - before and time.monotonic() < until:
        time.sleep(0.5)
    assert not ray_processes() - before


def processes_that_train():
    """Ids of the processes that train for a node of Ray."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            text = path.read_bytes()
            if b"resume" in text and b"/circle2d-" in text:
                found.append(int(path.parent.name))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("when", ["running", "stopped"])
def test_a_node_that_is_killed(tmp_path, monkeypatch, when):
    """The group goes on from its last checkpoint on the other node, to the same results."""
    pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    monkeypatch.setenv("RAY_worker_niceness", "0")
    configs = small_grid(tmp_path / "ray", steps=4000)
    (folder,) = configs
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
    nodes = [cluster.add_node(num_cpus=1) for _ in range(2)]
    killed = []

    def kill_the_busy_node():
        if killed or not (folder / "checkpoint.npz").exists() or share_done(folder) > 0.9:
            return
        (busy,) = (node for node in nodes if node_is_busy(node))
        if when == "stopped":  # wherever it is, be it in the middle of a file
            for process in processes_that_train():
                os.kill(process, signal.SIGSTOP)
        cluster.remove_node(busy, allow_graceful=False)
        for process in processes_that_train():
            os.kill(process, signal.SIGKILL)
        killed.append(busy)

    try:
        with (
            engine("ray", address=cluster.address) as ready,
            ready.workers(
                [(folder,)], lambda f: grid.finished(f, configs[f]), ()
            ) as workers,
        ):  # fmt: skip
            workers.run(kill_the_busy_node, 0.2)
            assert workers.failed == {}
    finally:
        cluster.shutdown()
    assert killed
    assert_as_trained_alone(folder, tmp_path / "alone")


def assert_as_trained_alone(folder, out):
    (alone,) = small_grid(out, steps=4000)
    train(alone)
    for name in ("episodes.csv", "updates.csv", "costs.npy", "visited.npy", "evaluation.json"):
        of_both = (of / "seed-3" / name for of in (folder, alone))
        assert next(of_both).read_bytes() == next(of_both).read_bytes(), name


@pytest.mark.slow
def test_a_driver_that_ends_between_the_files_of_a_checkpoint(tmp_path, monkeypatch):
    """Given again, the training goes on to the same results."""
    pytest.importorskip("ray")
    from agents.training import ray_engine

    configs = small_grid(tmp_path / "ray", steps=4000)
    (folder,) = configs
    written, write_whole = [], ray_engine.write_whole

    def write_some(path, content):
        if any(path.name == "checkpoint.npz" for path in written):
            raise KeyboardInterrupt
        write_whole(path, content)
        written.append(path)

    def run():
        with (
            engine("ray", 1) as ready,
            ready.workers([(folder,)], lambda f: grid.finished(f, configs[f]), ()) as workers,
        ):
            workers.run(lambda: None, 0.2)
            assert workers.failed == {}

    with monkeypatch.context() as patch:
        patch.setattr(ray_engine, "write_whole", write_some)
        with pytest.raises(KeyboardInterrupt):
            run()
    assert not grid.finished(folder, configs[folder])
    run()
    assert_as_trained_alone(folder, tmp_path / "alone")


def node_is_busy(node):
    """Whether a node has a task, by the cores that it has left."""
    from ray._private.state import available_resources_per_node

    left = available_resources_per_node()[node.node_id]
    return left.get("CPU", 0) == 0


def test_shards_are_a_partition(tmp_path):
    tasks = grid.circle2d_tasks((0, 1), mujoco=False)
    whole = grid.grid(tmp_path, tasks, ["cpo", "sac-lb", "trpo-lag"], (0,), 1000)
    parts = [grid.shard(whole, part, 4) for part in (1, 2, 3, 4)]
    assert sorted(folder for part in parts for folder in part) == sorted(whole)
    assert [len(part) for part in parts] == [2, 2, 1, 1]
    assert {next(iter(part.values())).algorithm for part in parts[:2]} == {"sac-lb"}


@pytest.mark.slow
def test_shards_train_the_whole(tmp_path, capsys):
    options = ["reproduce", "--levels", "1", "--algorithms", "trpo-lag", "cpo", "--seeds", "3"]
    options += ["--steps", "2000", "--backend", "eager", "--workers", "1"]
    parts = tmp_path / "parts" / "grid"
    for part in ("1/2", "2/2"):
        assert main([*options, "--out", str(parts), "--shard", part]) == 0
        assert f"part {part} is over" in capsys.readouterr().out
    assert not (parts / "report.md").exists()
    assert main([*options, "--out", str(tmp_path / "whole" / "grid")]) == 0
    assert main(["report", str(parts)]) == 0
    shutil.rmtree(parts / "pictures", ignore_errors=True)
    assert results(parts) == results(tmp_path / "whole" / "grid")
