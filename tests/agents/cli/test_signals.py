"""Signals at any time: one line, no traceback."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from agents.training.epochs import Epoch

from agents.cli import signals
from agents.cli.main import main


def test_ctrl_c_while_modules_are_imported():
    """At several times of the start, all processes at once."""
    command = [sys.executable, "-m", "agents.cli", "train", "--algorithm", "sac-lag", "--help"]
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
        with signals.handled():
            assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
            with pytest.raises(signals.Ended):
                os.kill(os.getpid(), signal.SIGTERM)
        assert signal.getsignal(signal.SIGTERM) is own
    finally:
        signal.signal(signal.SIGHUP, before)


def test_the_command_that_goes_on_names_the_users_modules():
    follow = signals.AfterEpoch(["my_algorithm"])
    follow(Epoch(Path("runs/a"), "mine", "Circle2D-1-v0", 100, {0: {"step": 50.0}}))
    follow.number = signal.SIGINT
    assert follow.words() == (
        "interrupted by SIGINT after 50 of 100 steps, with a checkpoint; "
        "'circle2d resume runs/a --import my_algorithm' goes on"
    )


def test_a_command_that_is_no_training_ends_at_once(monkeypatch, capsys):
    import agents.cli.scene as scene

    monkeypatch.setattr(scene, "run", lambda args: os.kill(os.getpid(), signal.SIGTERM) or 0)
    assert main(["scene"]) == 143
    assert capsys.readouterr().err.startswith("circle2d: interrupted by SIGTERM;")
