"""The grid of experiments: all of it is run, wherever it was stopped, and failures are named."""

import contextlib
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from small_runs import write_status

from agents.cli import reproduce as cli_grid
from agents.cli.main import main
from agents.cli.reproduce import _headline, _table
from agents.errors import UserError
from agents.paper import grid
from agents.paper.presets import preset
from agents.training.config import TrainConfig
from agents.training.loop import train
from agents.training.status import share_done, speed

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
def whole(tmp_path_factory):
    out = tmp_path_factory.mktemp("grid") / "whole"
    assert main([*COMMAND, str(out)]) == 0
    return out


def test_the_papers_grid():
    tasks = grid.circle2d_tasks((0, 1, 2, 3), mujoco=False)
    algorithms = ["trpo-lag", "cpo", "sac-lag", "sac-lb", "wcsac"]
    configs = grid.grid(Path("x"), tasks, algorithms, grid.SEEDS)
    assert sum(len(config.seeds) for config in configs.values()) == 60
    assert {(c.task, c.algorithm) for c in configs.values()} == {
        (task, name) for task in tasks for name in algorithms
    }
    for config in configs.values():
        assert config.hyperparameters == preset(config.algorithm, config.task)
        assert config.steps == 1_000_000
    assert [config.algorithm for config in configs.values()][-4:] == ["trpo-lag"] * 4


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
        assert process.returncode in (130, 0), err
        assert not processes_of(out)  # none is left behind
    assert main([*COMMAND, str(out)]) == 0
    assert results(out) == results(whole)
    assert (out / "report.csv").read_bytes() == (whole / "report.csv").read_bytes()


def test_the_display_shows_speeds(tmp_path):
    """Of each training as its status last said, and of all together; none where it says nothing."""
    folders = [tmp_path / name for name in ("a", "b", "new", "odd")]
    for folder in folders:
        folder.mkdir()
    write_status(folders[0], 0.5, 1200)
    write_status(folders[1], 0.25, 34)
    (folders[3] / "status.json").write_text("[]")
    assert [speed(folder) for folder in folders] == [1200, 34, None, None]
    assert [share_done(folder) for folder in folders] == [0.5, 0.25, 0, 0]
    groups = [(folders[0], tmp_path / "with a"), *((folder,) for folder in folders[1:])]
    shares = {folder: share_done(folder) for folder in folders}
    headline = _headline(groups, shares, 0.2, None)
    assert headline == "20 % done, 0 of 4 trainings, 1,234 steps/s in all"
    assert "trainings, 2 min left, 1,234" in _headline(groups, shares, 0.2, 118.0)
    table = _table(headline, groups, shares)
    assert table.title == headline
    names, done, speeds = (list(column.cells) for column in table.columns)
    assert names[:2] == [f"{folders[0]}\n{tmp_path / 'with a'}", str(folders[1])]
    assert done == ["50 %", "25 %", "0 %", "0 %"]
    assert speeds == ["1,200", "34", "", ""]


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
        (["--algorithms", "ppo"], "unknown algorithm 'ppo'"),
        (["--workers", "0"], "workers must be at least 1, got 0"),
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


def test_it_goes_on_with_the_backend_that_its_runs_began_with(tmp_path, monkeypatch):
    """Where a compiler came or went between two starts; whatever else lies in the folder."""
    command = [
        "reproduce",
        "--levels",
        "1",
        "--algorithms",
        "cpo",
        "--seeds",
        "3",
        "--steps",
        "500",
    ]
    command += ["--out", str(tmp_path)]
    chosen = []
    monkeypatch.setattr(cli_grid, "_train", lambda configs, count: {})
    monkeypatch.setattr(cli_grid, "report", lambda *a, **k: "")
    monkeypatch.setattr(cli_grid, "chosen_backend", lambda c: chosen.append(c) or "compiled")
    other = TrainConfig("cpo", "Circle2D-1-v0", (0,), 100, preset("cpo", "Circle2D-1-v0"))
    other.write(tmp_path / "another")
    for _ in range(2):
        assert main(command) == 0
    assert chosen == ["auto", "compiled"]
    monkeypatch.setattr(cli_grid, "chosen_backend", lambda c: "eager")
    assert main([*command, "--backend", "eager"]) == 2


def test_lengths_are_the_papers():
    tasks = ["Circle2D-1-v0", "Circle2DMuJoCo-1-v0", "circle2d_mj/SafetyPointGoal1-v0"]
    configs = grid.grid(Path("x"), tasks, ["cpo"], (0,))
    assert [config.steps for config in configs.values()] == [10**6, 10**6, 10**7]


def test_time_left_of_what_goes_on(tmp_path, monkeypatch):
    """Half is done when it starts; a tenth more takes 10 s, and so do the other four, each."""
    configs = grid.grid(tmp_path, ["Circle2D-1-v0"], ["cpo"], (3,), 500)
    grid.prepare(configs)
    (folder,) = configs
    headlines = []

    class Trained:
        running, over, failed = (), [], {}

        def __init__(self, groups, count, finished):
            pass

        def __enter__(self):
            return self

        def __exit__(self, *exception):
            pass

        def run(self, show):
            for clock, percent in ((100.0, 50), (110.0, 60)):
                monkeypatch.setattr(cli_grid.time, "monotonic", lambda clock=clock: clock)
                write_status(folder, percent / 100)
                show()

    write_status(folder, 0.5)
    monkeypatch.setattr(cli_grid, "Workers", Trained)
    monkeypatch.setattr(cli_grid.time, "monotonic", lambda: 100.0)
    headline = cli_grid._headline
    monkeypatch.setattr(cli_grid, "_headline", lambda *a: headlines.append(a[3]) or headline(*a))
    cli_grid._train(configs, 1)
    assert headlines[0] is None
    assert headlines[1] == pytest.approx(40.0)


def test_unknown_levels():
    with pytest.raises(UserError, match="levels"):
        grid.circle2d_tasks((), mujoco=True)
    assert grid.circle2d_tasks((1, 0, 1), mujoco=True) == [
        "Circle2DMuJoCo-1-v0",
        "Circle2DMuJoCo-0-v0",
    ]
