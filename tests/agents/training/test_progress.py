"""Progress as it is shown, by a clock and trainings made by hand."""

from io import StringIO
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

from agents.paper.presets import preset
from agents.training import progress
from agents.training.config import TrainConfig
from agents.training.progress import show_progress

TASK, STEPS = "Circle2D-1-v0", 1000


@pytest.fixture
def clock(monkeypatch):
    """Whose `now` is the time, and `compiled` what of it the compiler took."""
    told = SimpleNamespace(now=100.0)
    monkeypatch.setattr(progress.time, "monotonic", lambda: told.now)
    monkeypatch.setattr(progress.CLOCK, "seconds", 0.0)
    return told


def trainings(*steps):
    log = SimpleNamespace(recent=lambda: (-4.0, 2.5))
    return [
        SimpleNamespace(
            steps=np.array(steps),
            failed=np.zeros(len(steps), bool),
            done=min(steps) >= STEPS,
            log=log,
        )
    ]


def test_speed_and_time_left(tmp_path, capsys, clock):
    config = TrainConfig("cpo", TASK, (0, 1), STEPS, preset("cpo", TASK))
    config.write(tmp_path)
    with show_progress({tmp_path: config}) as on_epoch:
        clock.now = 110.0  # the first epoch, of 100 steps of either run, takes 10 s
        on_epoch(trainings(100, 100))
        clock.now = 120.0  # 200 more of each in 10 s, of which the compiler had 5
        progress.CLOCK.seconds = 5.0
        on_epoch(trainings(300, 300))
        clock.now = 120.1
        on_epoch(trainings(304, 304))  # no new tenth, and just shown
        clock.now = 135.0
        on_epoch(trainings(900, 1000))  # 1500 more of both together in 15 s, the slower one 600
        clock.now = 140.0
        on_epoch(trainings(1000, 1000))
    told = "cpo Circle2D-1-v0 x 2:"
    recent = "return -4.00, cost 2.50"
    assert capsys.readouterr().err.splitlines() == [
        f"{told} 10 % after 10 s, {recent}",
        f"{told} compiled in 5 s",
        f"{told} 30 % after 20 s, 80 steps/s, {recent}, 18 s left",  # 5 s for 20 %, so for 70 %
        f"{told} 90 % after 35 s, 85 steps/s, {recent}, 2 s left",  # 20 s for 80 %, so for 10 %
        f"{told} 100 % after 40 s, 72 steps/s, {recent}, evaluating",
    ]


def test_a_training_that_goes_on(tmp_path, capsys, clock):
    """Counts from where this process began."""
    config = TrainConfig("cpo", TASK, (0,), STEPS, preset("cpo", TASK))
    config.write(tmp_path)
    with show_progress({tmp_path: config}) as on_epoch:
        on_epoch(trainings(500))
        clock.now += 30.0
        on_epoch(trainings(800))
    *_, last = capsys.readouterr().err.splitlines()
    assert last.endswith("80 % after 30 s, 10 steps/s, return -4.00, cost 2.50, 20 s left")


def test_a_terminal_shows_the_same_time_left(tmp_path, monkeypatch, clock):
    """As `test_speed_and_time_left` has it, by hand."""
    shown = StringIO()
    console = Console(file=shown, force_terminal=True, width=150)
    monkeypatch.setattr(progress, "Console", lambda stderr: console)
    config = TrainConfig("cpo", TASK, (0, 1), STEPS, preset("cpo", TASK))
    with show_progress({tmp_path: config}) as on_epoch:
        clock.now = 110.0
        on_epoch(trainings(100, 100))
        clock.now, progress.CLOCK.seconds = 120.0, 5.0
        on_epoch(trainings(300, 300))
    assert "80 steps/s return -4.00, cost 2.50 18 s left" in shown.getvalue()
