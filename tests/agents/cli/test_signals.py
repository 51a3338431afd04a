"""Signals: the first ends a training after its epoch with a checkpoint, the second at once."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from agents.cli import showing
from agents.cli.main import AfterEpoch, Ended, handling_signals, main
from agents.training.callbacks import Epoch
from agents.training.trainer import Trainer

TRAIN = ["train", "sac-lag", "--seeds", "0", "--steps", "600", "--random-steps", "300"]
TRAIN += ["--backend", "eager", "--out"]


def kill_in_epoch(monkeypatch, numbers, epoch=3):
    """Send signals to this process while an epoch is trained."""
    run_epoch = Trainer.run_epoch

    def interrupted(self):
        run_epoch(self)
        if self.epoch == epoch:
            for number in numbers:
                os.kill(os.getpid(), number)

    monkeypatch.setattr(Trainer, "run_epoch", interrupted)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_the_first_ends_after_the_epoch_with_a_checkpoint(number, tmp_path, capsys, monkeypatch):
    out = tmp_path / "x"
    with monkeypatch.context() as patch:
        kill_in_epoch(patch, [number])
        assert main([*TRAIN, str(out)]) == 128 + number
    err = capsys.readouterr().err.splitlines()
    assert err[-1] == (
        f"circle2d: interrupted by {number.name} after 150 of 600 steps, with a checkpoint; "
        f"'circle2d resume {out}' goes on"
    )
    with np.load(out / "checkpoints" / "000000150.npz") as state:
        assert state["epoch"] == 3
    assert not (out / "results.npz").exists()
    if number is signal.SIGINT:
        assert main(["resume", str(out)]) == 0
        assert main([*TRAIN, str(tmp_path / "whole")]) == 0
        assert (out / "results.npz").read_bytes() == (tmp_path / "whole/results.npz").read_bytes()


def test_the_second_ends_at_once(tmp_path, capsys, monkeypatch):
    kill_in_epoch(monkeypatch, [signal.SIGINT, signal.SIGTERM])
    assert main([*TRAIN, str(tmp_path / "x")]) == 143
    assert "interrupted by SIGTERM; " in capsys.readouterr().err.splitlines()[-1]
    assert not list((tmp_path / "x").glob("checkpoints/*"))


@pytest.mark.slow
def test_ctrl_c_while_modules_are_imported():
    """At several times of the start, all processes at once."""
    command = [sys.executable, "-m", "agents.cli", "train", "sac-lag", "--help"]
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
    processes = [subprocess.Popen(command, text=True, **pipes) for _ in range(3)]
    time.sleep(0.4)  # Python itself begins
    for process in processes:
        time.sleep(0.3)
        process.send_signal(signal.SIGINT)
    for process in processes:
        _, err = process.communicate(timeout=60)
        assert "Traceback" not in err
        assert process.returncode in (130, -signal.SIGINT, 0)


def test_ignored_signals_stay_ignored_and_handlers_come_back():
    """As under nohup."""
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


def test_the_command_that_goes_on_names_the_users_modules():
    follow = AfterEpoch(["my_algorithm"])
    follow(Epoch(Path("runs/a"), "mine", "Circle2D-1-v0", 100, {0: {"step": 50.0}}))
    follow.number = signal.SIGINT
    assert "'circle2d resume runs/a --import my_algorithm' goes on" in follow.words()


def test_a_command_that_is_no_training_ends_at_once(monkeypatch, capsys):
    monkeypatch.setattr(showing, "scene", lambda args: os.kill(os.getpid(), signal.SIGTERM) or 0)
    assert main(["scene"]) == 143
    assert capsys.readouterr().err.startswith("circle2d: interrupted by SIGTERM;")
