"""When checkpoints are written, and what status and progress say, by a clock set by the test."""

from types import SimpleNamespace

import numpy as np
import pytest
from small_runs import TRPO, write_status
from toy_family import known

import agents
from agents.presets import preset
from agents.training import callbacks, trainer
from agents.training.callbacks import StatusFile, sessions, share_done, show_progress, speed
from agents.training.config import TrainConfig
from agents.training.files import read_json

TASK, STEPS = "Circle2D-1-v0", 1000


class Clock:
    def __init__(self):
        self.now = 100.0

    def monotonic(self):
        return self.now


@pytest.fixture
def clock(monkeypatch):
    """A clock of training, whose time is its `now`."""
    own = Clock()
    for module in (callbacks, trainer):
        monkeypatch.setattr(module, "time", own)
    return own


@pytest.mark.parametrize(("writing", "each"), [(0.0, 1), (1.0, 5), (0.25, 2)])
def test_writing_takes_2_percent_of_the_time_at_most(tmp_path, monkeypatch, clock, writing, each):
    """After each epoch, of 10 s, a checkpoint is due by steps; that of the last epoch is always
    written."""
    saved, save = [], trainer.Trainer.save

    def slowly(it):
        write = trainer.write_arrays

        def slow(*args):
            clock.now += writing / 2
            write(*args)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(trainer, "write_arrays", slow)
            save(it)
        saved.append(int(it.epochs.max()))

    def passes(epoch):
        clock.now += 10.0

    monkeypatch.setattr(trainer.Trainer, "save", slowly)
    with known():
        more = {"checkpoint_every": 50, "steps": 1000, "seeds": 0, "on_epoch": passes}
        runs = agents.train("toy", TASK, out=tmp_path / "x", **more)
    assert saved[0] == 1
    assert saved[-1] == 20
    assert set(np.diff(saved[:-1])) == {each}
    kept = sorted(path.name for path in (runs.folder / "checkpoints").iterdir())
    assert len(kept) == 2
    assert kept[-1] == "000001000.npz"
    assert len(list((runs.folder / "steps").iterdir())) == len(saved)


def trainer_at(*steps, failed=(), folder=None):
    """Return a stand-in for a trainer whose runs have taken these steps."""
    failures = np.where(np.isin(np.arange(len(steps)), failed), "failed", "")
    config = TrainConfig("cpo", (TASK,), tuple(range(len(steps))), STEPS, preset("cpo", TASK))
    numbers = {"steps": np.array(steps), "failures": failures, "done": min(steps) >= STEPS}
    recorder = SimpleNamespace(recent=(-4.0, 2.5))
    more = {"recorder": recorder, "config": config, "folder": folder}
    return SimpleNamespace(**numbers, **more, learner=SimpleNamespace(episodes=1))


def test_the_status_of_a_training(tmp_path, clock):
    status = StatusFile(trainer_at(0, 0, folder=tmp_path))
    clock.now = 110.0
    status(trainer_at(100, 100))
    assert read_json(tmp_path / "status.json")["steps_per_second"] is None
    assert share_done(tmp_path) == 0.1
    clock.now = 120.0
    status(trainer_at(300, 300))
    assert speed(tmp_path) == (600 - 200) / 10
    clock.now = 120.9
    status(trainer_at(400, 400))  # less than a second after the last one, so not written
    assert share_done(tmp_path) == 0.3
    clock.now = 130.0
    status(trainer_at(600, 410, failed=[1]))
    assert share_done(tmp_path) == 0.6
    assert [one["seconds"] for one in sessions(tmp_path).values()] == [30.0]
    later = StatusFile(trainer_at(600, 410, folder=tmp_path))
    clock.now = 141.0
    later(trainer_at(1000, 1000))
    assert [one["seconds"] for one in sessions(tmp_path).values()] == [30.0, 11.0]
    assert "torch" in [*sessions(tmp_path).values()][1]["versions"]


@pytest.mark.parametrize(
    "content",
    [
        *("[]", '{"share": 1', '{"share": NaN, "steps_per_second": null}'),
        '{"share": 1.5, "steps_per_second": [1], "sessions": [1]}',
    ],
)
def test_a_malformed_status_file_is_ignored(tmp_path, content):
    (tmp_path / "status.json").write_text(content)
    assert (share_done(tmp_path), speed(tmp_path), sessions(tmp_path)) == (0.0, None, {})
    write_status(tmp_path, 0.25, 34, one=3)
    assert (share_done(tmp_path), speed(tmp_path)) == (0.25, 34)
    assert sessions(tmp_path) == {"one": {"seconds": 3}}


def test_progress_by_a_clock(capsys, clock):
    with show_progress(trainer_at(0, 0).config) as on_epoch:
        clock.now = 110.0  # the first epoch, of 100 steps in each run, takes 10 s
        on_epoch(trainer_at(100, 100))
        clock.now = 115.0  # 200 more steps of each
        on_epoch(trainer_at(300, 300))
        clock.now = 120.1
        on_epoch(trainer_at(304, 304))  # no new tenth
        clock.now = 135.0
        on_epoch(trainer_at(900, 1000))  # 1300 more steps in both, 600 of the slower one
        clock.now = 140.0
        on_epoch(trainer_at(1000, 1000))
        clock.now = 152.0  # the evaluation
    told, recent = "cpo Circle2D-1-v0 x 2:", "return -4.00, cost 2.50"
    assert capsys.readouterr().err.splitlines() == [
        f"{told} networks are computed in C++",
        f"{told} 10 % after 10 s, {recent}",
        f"{told} 30 % after 15 s, 80 steps/s, {recent}, 18 s left",  # 5 s for 20 %, so for 70 %
        f"{told} 90 % after 35 s, 68 steps/s, {recent}, 3 s left",  # 25 s for 80 %, so for 10 %
        f"{told} 100 % after 40 s, 60 steps/s, {recent}, evaluating 100 episodes of each policy",
        f"{told} the evaluation took 12 s, not counted in the speeds above",
    ]


def test_checkpoints_are_not_more_frequent_than_their_steps(tmp_path, clock):
    def passes(epoch):
        clock.now += 10.0

    more = TRPO | {"checkpoint_every": 300, "steps": 1000, "seeds": (0, 1), "on_epoch": passes}
    runs = agents.train("cpo", TASK, out=tmp_path / "x", **more)
    names = sorted(path.stem for path in (runs.folder / "steps").iterdir())
    assert names == ["000000300", "000000600", "000000900", "000001000"]
