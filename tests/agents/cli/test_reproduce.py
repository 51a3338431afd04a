"""`circle2d reproduce`: all of the grid is run, wherever it was stopped, and failures are named."""

import contextlib
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
from agents.training.loop import train

from agents.cli.main import main
from agents.paper import grid
from agents.paper.presets import preset
from agents.training.config import TrainConfig

COMMAND = ["reproduce", "--algorithms", "trpo-lag", "cpo", "--levels", "1", "--seeds", "3", "4"]
COMMAND += ["--steps", "2000", "--workers", "2", "--out"]
RESULTS = ("episodes.csv", "updates.csv", "evaluation.json", "visited.npy", "costs.npy")


def results(folder):
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for name in RESULTS
        for path in folder.rglob(name)
    }


@pytest.fixture(scope="module")
def command(tmp_path_factory):
    """A grid that ran in a process of its own: its folder, and what it printed on stderr."""
    out = tmp_path_factory.mktemp("grid") / "whole"
    started = [sys.executable, "-m", "agents.cli", *COMMAND, str(out)]
    done = subprocess.run(started, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return out, done.stderr


@pytest.fixture(scope="module")
def whole(command):
    return command[0]


def test_progress_is_told_in_lines(command):
    """Where stderr is no terminal: a line for each training that ends, and one a tenth."""
    out, err = command
    ends = re.findall(r"^(.+): done after \d+ s$", err, re.MULTILINE)
    assert sorted(ends) == [str(out / "Circle2D-1-v0" / name) for name in ("cpo", "trpo-lag")]
    line = r"^(\d+) % done, (\d) of 2 trainings(?:, (.+) left)?, ([\d,]+) steps/s in all$"
    lines = [(int(a), int(b), c) for a, b, c, _ in re.findall(line, err, re.MULTILINE)]
    assert lines
    assert lines == sorted(lines, key=lambda told: told[:2])
    assert lines[-1] == (100, 2, "0 s")


@pytest.mark.slow
def test_progress_on_a_terminal_is_a_table(tmp_path):
    """One row for each training, and its speed, in steps a second."""
    shown = os.environ | {"FORCE_COLOR": "1", "TERM": "xterm", "COLUMNS": "250"}
    command = [sys.executable, "-m", "agents.cli", *COMMAND, str(tmp_path), "--steps", "20000"]
    done = subprocess.run(command, env=shown, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    rows = re.findall(r"Circle2D-1-v0/(\S+)\W+(\d+) %\W+([\d,]+) ", done.stderr)
    assert {name for name, _, _ in rows} == {"cpo", "trpo-lag"}
    assert all(0 <= int(percent) <= 100 for _, percent, _ in rows)
    assert re.search(r"100 % done, 2 of 2 trainings", done.stderr)


@pytest.mark.slow
def test_a_folder_that_fails_takes_none_of_its_group_with_it(tmp_path, capsys):
    out = tmp_path / "grid"
    command = ["reproduce", "--levels", "0", "1", "--seeds", "3", "--steps", "2000"]
    command += ["--algorithms", "cpo", "trpo-lag", "--workers", "1", "--out", str(out)]
    tasks = grid.circle2d_tasks((0, 1), mujoco=False)
    grid.prepare(grid.grid(out, tasks, ["cpo", "trpo-lag"], (3,), 2000))
    damaged = out / "Circle2D-1-v0" / "cpo" / "checkpoint.npz"
    damaged.write_bytes(b"no checkpoint")
    assert main(command) == 1
    _, err = capsys.readouterr()
    assert re.search(r"circle2d: .*1-v0/cpo failed: circle2d: .*1-v0/cpo/.*damaged", err)
    assert err.count("cpo failed: ") == 1
    for folder in ("0-v0/cpo", "0-v0/trpo-lag", "1-v0/trpo-lag"):
        assert f"Circle2D-{folder}: done" in err
    damaged.unlink()
    assert main(command) == 0
    config = TrainConfig("cpo", "Circle2D-1-v0", (3,), 2000, preset("cpo", "Circle2D-1-v0"))
    config.write(tmp_path / "alone")
    train(tmp_path / "alone")
    assert results(tmp_path / "alone") == results(out / "Circle2D-1-v0" / "cpo")


def test_runs_are_those_of_train(whole, tmp_path, capsys):
    task = "Circle2D-1-v0"
    config = TrainConfig("cpo", task, (3, 4), 2000, preset("cpo", task))
    config.write(tmp_path / "alone")
    train(tmp_path / "alone")
    assert results(tmp_path / "alone") == results(whole / task / "cpo")
    assert "CPO (2,000 steps), mean of 2" in (whole / "report.md").read_text()
    assert "TRPO-Lag (2,000 steps), mean of 2" in (whole / "report.md").read_text()


def test_again_nothing_is_trained(whole, capsys):
    before = results(whole)
    assert main([*COMMAND, str(whole)]) == 0
    assert results(whole) == before
    logs = [path.read_text() for path in whole.rglob("worker.log")]
    assert len(logs) == 2
    assert all(log.count("100 % after") == 1 for log in logs)


def processes_of(folder):
    """The command lines of running processes that name a folder."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):  # it ended meanwhile
            found.append(path.read_bytes())
    assert found
    return [line for line in found if str(folder).encode() in line]


@pytest.mark.slow
def test_stopped_in_the_middle_it_goes_on(whole, tmp_path):
    out = tmp_path / "stopped"
    command = [sys.executable, "-m", "agents.cli", *COMMAND, str(out)]

    def told():
        return {path: path.read_bytes() for path in out.rglob("status.json")}

    for number in (signal.SIGINT, signal.SIGTERM):
        before = told()
        process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        deadline = time.monotonic() + 120
        while process.poll() is None and told() == before:  # until its workers train
            assert time.monotonic() < deadline
            time.sleep(0.1)
        process.send_signal(number)
        _, err = process.communicate(timeout=60)
        assert process.returncode in (128 + number, 0), err
        assert not processes_of(out)  # none is left behind
    assert main([*COMMAND, str(out)]) == 0
    assert results(out) == results(whole)
    assert (out / "report.csv").read_bytes() == (whole / "report.csv").read_bytes()


def kill_while_it_trains(command, out):
    """Start a command, and end it by SIGKILL once it trains; returns when all must be over."""
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 120
    while not list(out.rglob("status.json")):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    process.kill()
    process.wait()
    return deadline


@pytest.mark.slow
def test_killed_it_leaves_no_worker_and_goes_on_at_once(tmp_path):
    """SIGKILL reaches the parent alone; the second start waits for what is left of the first."""
    out = tmp_path / "killed"
    command = [sys.executable, "-m", "agents.cli", *COMMAND, str(out), "--steps", "20000"]
    kill_while_it_trains(command, out)
    again = subprocess.run(command, capture_output=True, text=True, check=False)
    assert again.returncode == 0, again.stderr
    assert "failed" not in again.stderr
    assert not processes_of(out)


@pytest.mark.slow
def test_the_workers_of_a_killed_command_end(tmp_path):
    out = tmp_path / "killed"
    command = [sys.executable, "-m", "agents.cli", *COMMAND, str(out), "--steps", "1000000"]
    deadline = kill_while_it_trains(command, out)
    while processes_of(out):
        assert time.monotonic() < deadline
        time.sleep(0.1)


def test_one_failure_does_not_stop_the_others(tmp_path, capsys):
    out = tmp_path / "grid"
    command = [*COMMAND, str(out), "--workers", "1"]
    configs = grid.grid(out, ["Circle2D-1-v0"], ["cpo", "trpo-lag"], (3, 4), 2000)
    grid.prepare(configs)
    (out / "Circle2D-1-v0" / "cpo" / "checkpoint.npz").write_bytes(b"no checkpoint")
    assert main(command) == 1
    out_text, err = capsys.readouterr()
    assert re.search(r"circle2d: .*Circle2D-1-v0/cpo failed: circle2d: .*damaged", err)
    assert "TRPO-Lag (2,000 steps), mean of 2" in out_text
    assert "left out: " in out_text


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--levels", "5"], r"levels must be some of \[0, 1, 2, 3\], got \[5\]"),
        (["--algorithms", "cop"], "unknown algorithm 'cop': did you mean 'cpo'"),
        (["--workers", "0"], r"workers must be in \[1, 1024\], got 0"),
        (["--tasks", "Nope-v3", "--levels", "0", "1", "2", "3"], "Nope"),
        (["--tasks", "Nope-v3"], "give either tasks, or levels and mujoco"),
        (["--steps", "0"], "steps must be at least 1, got 0"),
        (["--steps", "3000"], r"holds runs with other settings: steps 2000 \(now 3000\); choose"),
        (["--algorithms"], "algorithms must be some of trpo-lag, .*, got none"),
    ],
)
def test_mistakes(whole, options, message, capsys):
    assert main([*COMMAND, str(whole), *options]) == 2
    assert re.search(message, capsys.readouterr().err)


def test_it_goes_on_with_the_backend_that_its_runs_began_with(tmp_path, capsys):
    """Runs were begun as compiled code; the tests switch compiling off, so that `auto` would be
    eager, and going on is refused."""
    command = ["reproduce", "--algorithms", "cpo", "--levels", "1", "--seeds", "3"]
    command += ["--steps", "2000", "--workers", "1", "--out", str(tmp_path)]
    other = TrainConfig("cpo", "Circle2D-1-v0", (0,), 100, preset("cpo", "Circle2D-1-v0"))
    other.write(tmp_path / "another")
    configs = grid.grid(tmp_path, ["Circle2D-1-v0"], ["cpo"], (3,), 2000)
    grid.prepare({folder: replace(c, backend="compiled") for folder, c in configs.items()})
    assert main(command) == 2
    assert re.search(r"backend 'compiled' .*TORCH_COMPILE_DISABLE", capsys.readouterr().err)
    assert main([*command, "--backend", "eager"]) == 2
    assert "backend compiled (now eager)" in capsys.readouterr().err
