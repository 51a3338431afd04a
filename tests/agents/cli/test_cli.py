"""Commands: what they print, the files they write, their exit status, and how signals end them."""

import dataclasses
import os
import re
import shutil
import signal
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
import toys
from small_runs import lines_of

import agents
from agents.cli import showing
from agents.cli.main import AfterEpoch, Ended, handling_signals, main
from agents.cli.training import TrainOptions
from agents.errors import EXTRA
from agents.presets import preset
from agents.training.callbacks import Epoch, share_done
from agents.training.config import TrainConfig
from agents.training.policy import load_policy
from agents.training.trainer import Trainer

TRAIN = ["train", "sac-lag", "--seeds", "0", "1", "--steps", "300", "--backend", "numpy"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("runs") / "first"
    assert main([*TRAIN, "--out", str(path), "--random-steps", "150"]) == 0
    return path


def test_train_and_report_print_and_write_the_table(folder, capsys):
    assert {path.name for path in folder.iterdir()} == {
        *(".lock", "checkpoints", "config.json", "report.csv", "report.md", "results.npz"),
        *("status.json", "steps", "measures.csv"),
    }
    assert main(["report", str(folder)]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    names = re.findall(r"^\| (SAC-Lag.*?) +\|", out, re.MULTILINE)
    assert names == [
        "SAC-Lag (random_steps 150), mean of 2",
        "SAC-Lag, paper (3 seeds)",
        "SAC-Lag (random_steps 150), seed 0",
        "SAC-Lag (random_steps 150), seed 1",
    ]
    assert [row["seed"] for row in lines_of(folder / "report.csv") if row["seed"]] == ["0", "1"]
    assert share_done(folder) == 1.0


def test_evaluate_plays_a_policy_of_the_package(capsys):
    name = "pretrained:trpo-lag/Circle2D-2-v0"
    for episodes, how in ((1, "ranges"), (3, "ranges"), (8, "95 % t intervals")):
        assert main(["evaluate", name, "--episodes", str(episodes)]) == 0
        expected = [f"{name}: means over {episodes} episodes, with {how}"]
        for deterministic in (True, False):
            own = agents.evaluate(name, episodes=episodes, deterministic=deterministic)
            kind = "deterministic" if deterministic else "stochastic"
            told = []
            for values in (own.returns, own.costs):
                if episodes == 1:
                    told.append(f"{values.mean():.2f}")
                elif episodes == 3:
                    told.append(f"{values.mean():.2f} ({values.min():.2f} to {values.max():.2f})")
                else:
                    margin = 2.364624 * values.std(ddof=1) / 8**0.5  # t with 7 degrees of freedom
                    low, high = values.mean() - margin, values.mean() + margin
                    told.append(f"{values.mean():.2f} [{low:.2f}, {high:.2f}]")
            words = f"J_R {told[0]}, J_C {told[1]}"
            expected.append(f"Circle2D-2-v0, seed 100, {kind} policy: {words}")
        assert capsys.readouterr().out.splitlines() == expected


def test_evaluate_replaces_what_reports_show(folder, tmp_path, capsys):
    """`resume` of a finished training keeps the new evaluation, unless its file is damaged."""
    copy = tmp_path / "runs"
    shutil.copytree(folder, copy)
    name = "Circle2D-1-v0/0/evaluation/deterministic/returns"
    assert main(["evaluate", str(copy), "--episodes", "7"]) == 0
    assert "means over 7 episodes" in capsys.readouterr().out
    with np.load(copy / "results.npz") as results:
        assert results[name].shape == (7,)
    content = (copy / "results.npz").read_bytes()
    assert main(["resume", str(copy)]) == 0
    assert "was done already, all " in capsys.readouterr().err
    assert (copy / "results.npz").read_bytes() == content
    (copy / "results.npz").write_bytes(content[:-40])
    assert main(["resume", str(copy)]) == 0
    with np.load(copy / "results.npz") as results, np.load(folder / "results.npz") as first:
        np.testing.assert_array_equal(results[name], first[name])


def test_options_reach_the_training(tmp_path):
    out = tmp_path / "x"
    options = ["--cost-limit", "3", "--hidden", "32", "16", "--activation", "relu"]
    options += ["--task-parameters", "constraint_radius", "3.0", "--replay-size", "2e4"]
    tasks = ["--task", "Circle2D-1", "circle2d_mj:Circle2D-3-v0"]
    assert main([*TRAIN, *tasks, *options, "--steps", "1.5e2", "--out", str(out)]) == 0
    config = TrainConfig.read(out)
    names = ("Circle2D-1-v0", "circle2d_mj-Circle2D-3-v0")
    assert [run.prefix for run in config.runs] == [f"{n}/{seed}/" for n in names for seed in (0, 1)]
    assert (config.steps, config.hyperparameters.replay_size) == (150, 20_000)
    assert config.task_parameters == {"constraint_radius": 3.0}
    for name in ("Circle2D-3-v0", "circle2d_mj:Circle2D-3-v0"):
        assert load_policy(out, 1, task=name).task == "circle2d_mj:Circle2D-3-v0"
    own = config.hyperparameters
    assert (own.cost_limit, own.hidden, own.activation) == (3.0, (32, 16), "relu")


def test_help_names_every_option_with_its_default(capsys):
    with pytest.raises(SystemExit) as done:
        main(["train", "sac-lag", "--help"])
    assert done.value.code == 0
    text = re.sub(r"[│\s]+", " ", capsys.readouterr().out)
    own = preset("sac-lag", "Circle2D-1-v0")
    for field in (*dataclasses.fields(TrainOptions), *dataclasses.fields(own)):
        name = "import" if field.name == "imports" else field.name
        assert f"--{name.replace('_', '-')} " in text or f"--{name.replace('_', '-')}," in text
        value = getattr(own, field.name, field.default)
        if isinstance(value, (int, float, str)) and not isinstance(value, bool):
            assert f"(default: {value})" in text
    assert "Limit d of the discounted cost return" in text
    assert main(["--help"]) == 0
    assert main(["train", "--help"]) == 0
    assert "sac-lb-streak" in capsys.readouterr().out
    assert main([]) == 2


def test_a_failed_run_is_named_and_the_status_is_1(tmp_path, capsys, monkeypatch):
    run_epoch = Trainer.run_epoch

    def poisoned(self):
        if self.epochs.max() == 5:
            self.learner._state.actor[1, 0] = np.nan
        run_epoch(self)

    monkeypatch.setattr(Trainer, "run_epoch", poisoned)
    out = tmp_path / "runs"
    options = ["--seeds", "3", "4", "5", "--random-steps", "0", "--out", str(out)]
    assert main(["train", "sac-lag", "--steps", "300", "--backend", "numpy", *options]) == 1
    table, err = capsys.readouterr()
    # NaN actions make the sixth episode void in its first step.
    said = f"circle2d: {out}: Circle2D-1-v0, seed 4: failed at step 250"
    assert err.splitlines()[-1].startswith(said)
    assert "failed at step 250" in table
    assert "mean of 2" in table
    assert main(["resume", str(out)]) == 1
    assert main(["evaluate", str(out), "--episodes", "2"]) == 1
    assert main(["report", str(out)]) == 1
    assert main(["compare", str(out), str(out)]) == 1
    assert main(["plot", str(out), "--out", str(tmp_path / "figure.svg")]) == 1
    (mean,) = (row for row in lines_of(out / "report.csv") if row["kind"] == "mean")
    assert mean["seeds"] == "2"
    capsys.readouterr()


def test_a_damaged_folder_does_not_hide_the_others(folder, tmp_path, capsys):
    for name in ("good", "bad", "cut"):
        shutil.copytree(folder, tmp_path / name)
    (tmp_path / "bad" / "config.json").write_text("{")
    results = tmp_path / "cut" / "results.npz"
    results.write_bytes(results.read_bytes()[:-100])
    assert main(["report", str(tmp_path)]) == 1
    out = capsys.readouterr().out
    assert "mean of 2" in out
    assert len(re.findall("left out", out)) == 2
    assert re.search(r"left out: \S*/cut\b.*is damaged", out)
    shutil.rmtree(tmp_path / "good")
    assert main(["report", str(tmp_path)]) == 2
    assert "no complete runs" in capsys.readouterr().err


def test_an_error_of_the_users_own_shows_its_traceback(tmp_path, capsys, monkeypatch):
    toys.register()
    command = [*TRAIN, "--task", "Broken", "--task-parameters", "how", "raise", "at", "30"]
    assert main([*command, "--out", str(tmp_path / "x")]) == 1
    *trace, last = capsys.readouterr().err.splitlines()
    assert "Traceback (most recent call last):" in trace
    assert "LookupError: motor" in trace
    assert re.search(r"circle2d: .*Broken-v0.*step 10 .*toys\.py, line \d+", last)
    (tmp_path / "my_typo.py").write_text("1 / 0\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert main(["report", str(tmp_path), "--import", "my_typo"]) == 1
    assert "ZeroDivisionError" in capsys.readouterr().err


def test_an_output_that_nobody_reads_to_its_end_is_no_error():
    shell = f"{sys.executable} -m agents.cli scene | head -n 1"
    done = subprocess.run(["bash", "-c", shell], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("<mujoco")
    assert done.stderr == ""


HEAVY = ("torch", "tyro", "matplotlib", "rich", "mujoco", "OpenGL")


def test_no_heavy_import_before_a_command():
    """Not even for the help, which has the names of all algorithms."""
    code = f"""
import sys
from agents.cli.main import AfterEpoch, Ended, handling_signals, main
assert main(["--help"]) == 0 and main(["trian"]) == 2
assert not set({HEAVY}) & set(sys.modules), sorted(set({HEAVY}) & set(sys.modules))
"""
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)


def test_torch_is_imported_where_networks_are_needed():
    """Commands that read and print do not import it, nor do configurations and results."""
    code = """
import sys
import agents.results, agents.training.config
from agents.cli.main import main
assert main(["zoo"]) == 0 and main(["compare", "nowhere", "nowhere"]) == 2
assert "torch" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)


def test_hints_of_missing_packages_cover_the_extra_train():
    """Except for imageio, which every installation has."""
    project = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text())["project"]
    names = [re.match(r"\w+", text)[0] for text in project["optional-dependencies"]["train"]]
    assert set(EXTRA) == set(names) - {"imageio"}


ONE = ["train", "sac-lag", "--seeds", "0", "--steps", "300", "--random-steps", "100", "--out"]


def kill_in_epoch(monkeypatch, numbers, epoch=3):
    """Send signals to this process at the end of an epoch."""
    run_epoch = Trainer.run_epoch

    def interrupted(self):
        run_epoch(self)
        if self.epochs.max() == epoch:
            for number in numbers:
                os.kill(os.getpid(), number)

    monkeypatch.setattr(Trainer, "run_epoch", interrupted)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_the_first_signal_ends_a_training_after_its_epoch_with_a_checkpoint(
    number, tmp_path, capsys, monkeypatch
):
    out = tmp_path / "x"
    with monkeypatch.context() as patch:
        kill_in_epoch(patch, [number])
        assert main([*ONE, str(out)]) == 128 + number
    err = capsys.readouterr().err.splitlines()
    assert err[-1].startswith(f"circle2d: interrupted by {number.name} after 150 of 300 steps")
    assert f"'circle2d resume {out}'" in err[-1]
    with np.load(out / "checkpoints" / "000000150.npz") as state:
        assert state["epoch"] == 3
    assert not (out / "results.npz").exists()
    if number is signal.SIGINT:
        assert main(["resume", str(out)]) == 0
        assert main([*ONE, str(tmp_path / "whole")]) == 0
        assert (out / "results.npz").read_bytes() == (tmp_path / "whole/results.npz").read_bytes()


def test_the_second_signal_ends_a_training_at_once(tmp_path, capsys, monkeypatch):
    kill_in_epoch(monkeypatch, [signal.SIGINT, signal.SIGTERM])
    assert main([*ONE, str(tmp_path / "x")]) == 143
    assert "interrupted by SIGTERM; " in capsys.readouterr().err.splitlines()[-1]
    assert not list((tmp_path / "x").glob("checkpoints/*"))


def test_ignored_signals_stay_ignored_and_handlers_come_back():
    """Such as SIGHUP under nohup."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    own = signal.getsignal(signal.SIGTERM)
    try:
        with handling_signals():
            assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
            with pytest.raises(Ended):
                os.kill(os.getpid(), signal.SIGTERM)
        assert signal.getsignal(signal.SIGTERM) is own
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_command_that_is_no_training_ends_at_once(monkeypatch, capsys):
    monkeypatch.setattr(showing, "scene", lambda args: os.kill(os.getpid(), signal.SIGTERM) or 0)
    assert main(["scene"]) == 143
    assert capsys.readouterr().err.startswith("circle2d: interrupted by SIGTERM;")


def test_the_command_that_goes_on_names_the_users_modules():
    follow = AfterEpoch(["my_algorithm"])
    follow(Epoch(Path("runs/a"), "mine", "Circle2D-1-v0", 100, {0: {"step": 50.0}}))
    follow.number = signal.SIGINT
    assert "'circle2d resume runs/a --import my_algorithm'" in follow.words()
