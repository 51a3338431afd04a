"""`circle2d reproduce` trains the whole grid, also after an interruption, and names failures."""

import contextlib
import io
import re
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from small_runs import processes, wait_until

from agents.cli import training
from agents.cli.main import main
from agents.cli.options import parse
from agents.paper.grid import PAPER_ALGORITHMS, SAFETY
from agents.training import grid

COMMAND = ["reproduce", "--algorithms", "trpo-lag", "cpo", "--levels", "1", "--seeds", "3"]
COMMAND += ["--steps", "1100", "--workers", "1", "--out"]
STARTED = [sys.executable, "-m", "agents.cli", *COMMAND]


def results(folder):
    """Return the bytes of each `results.npz`, by path."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("results.npz")}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The folder of a finished grid, and what was printed on stderr, which is no terminal.

    OpenGL would fail here, so that neither training nor the report uses it.
    """
    out = tmp_path_factory.mktemp("grid") / "whole"
    with contextlib.redirect_stderr(io.StringIO()) as err, pytest.MonkeyPatch.context() as patch:
        patch.setenv("MUJOCO_GL", "nonsense")
        assert main([*COMMAND, str(out)]) == 0
    return out, err.getvalue()


def test_it_trains_and_reports_all(whole):
    """Where stderr is no terminal, each training that ends has a line."""
    out, err = whole
    assert set(results(out)) == {f"Circle2D-1-v0/{n}/results.npz" for n in ("cpo", "trpo-lag")}
    assert err.count(": done after ") == 2
    assert "100 % done, 2 of 2 trainings" in err.splitlines()[-1]
    for title in ("CPO", "TRPO-Lag"):
        assert f"{title}, mean of 1" in (out / "report.md").read_text()
    assert "Visited states" in (out / "index.html").read_text()


def test_the_same_command_again_trains_nothing_and_gives_the_same_report(whole, capsys):
    out, _ = whole
    before = {path: path.read_bytes() for path in (*out.rglob("*.npz"), out / "index.html")}
    assert main([*COMMAND, str(out)]) == 0
    assert {path: path.read_bytes() for path in (*out.rglob("*.npz"), out / "index.html")} == before
    assert main([*COMMAND, str(out), "--steps", "3000"]) == 2
    assert "holds runs with other settings: steps 1100 (now 3000)" in capsys.readouterr().err


def test_it_goes_on_with_the_backend_that_its_runs_began_with(tmp_path, capsys):
    configs = grid.grid(tmp_path, ["Circle2D-1-v0"], ["cpo"], (3,), 1100)
    grid.prepare({folder: replace(c, backend="numpy") for folder, c in configs.items()})
    command = [word for word in COMMAND if word != "trpo-lag"]
    other = [*command, str(tmp_path), "--backend", "c++"]
    assert main(other) == 2
    assert "holds runs with other settings: backend numpy (now c++)" in capsys.readouterr().err
    assert main([*command, str(tmp_path)]) == 0


@pytest.mark.slow
def test_one_failure_does_not_stop_the_others(tmp_path, capsys):
    configs = grid.grid(tmp_path, ["Circle2D-1-v0"], ["cpo", "trpo-lag"], (3,), 1100)
    grid.prepare(configs)
    damaged = tmp_path / "Circle2D-1-v0" / "cpo" / "checkpoints" / "000000500.npz"
    damaged.parent.mkdir()
    damaged.write_bytes(b"no checkpoint")
    assert main([*COMMAND, str(tmp_path)]) == 1
    out, err = capsys.readouterr()
    assert re.search(r"circle2d: .*Circle2D-1-v0/cpo failed: .*damaged", err)
    assert "TRPO-Lag, mean of 1" in out
    assert "left out: " in out


def test_a_shard_without_trainings_is_over_at_once(tmp_path, capsys):
    """Four shards share two trainings: the last two have none."""
    assert main([*COMMAND, str(tmp_path / "x"), "--shard", "4/4"]) == 0
    assert "part 4/4 is done" in capsys.readouterr().out
    assert not (tmp_path / "x").exists()


def trainings(choice):
    words = ["--out", "runs", choice]
    return training._configs(parse(training.ReproduceOptions, "reproduce", words))


def test_quick_is_small_and_safety_is_the_papers():
    configs = trainings("--quick")
    assert {config.steps for config in configs.values()} == {10_000}
    assert {config.seeds for config in configs.values()} == {(0, 1)}
    # Two seeds on four levels are one training.
    assert set(configs) == {Path("runs", name) for name in PAPER_ALGORITHMS}
    configs = trainings("--safety")
    assert {task for c in configs.values() for task in c.tasks} == set(SAFETY)
    assert {config.steps for config in configs.values()} == {10_000_000}


@pytest.mark.slow
def test_stopped_in_the_middle_it_leaves_no_worker_and_goes_on(whole, tmp_path):
    """test_launcher.py has a parent process that is killed."""
    command = [*STARTED, str(tmp_path), "--shard", "1/1"]  # without a report
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    wait_until(lambda: process.poll() is not None or list(tmp_path.rglob("status.json")), 120)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode in (128 + signal.SIGINT, 0), err
    assert not processes(tmp_path)
    again = subprocess.run(command, capture_output=True, text=True, check=False)
    assert again.returncode == 0, again.stderr
    assert "part 1/1 is done" in again.stdout
    assert not (tmp_path / "report.md").exists()
    assert not processes(tmp_path)
    assert results(tmp_path) == results(whole[0])
