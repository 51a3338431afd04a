"""Status files of trainings: numbers by a clock, sessions, and files of other hands."""

from types import SimpleNamespace

import numpy as np
import pytest
from small_runs import write_status

from agents.training import status
from agents.training.files import read_json
from agents.training.status import StatusFiles, sessions, share_done, speed


@pytest.fixture
def clock(monkeypatch):
    time = SimpleNamespace(now=100.0)
    monkeypatch.setattr(status.time, "monotonic", lambda: time.now)
    monkeypatch.setattr(status.CLOCK, "seconds", 0.0)
    return time


def training(*steps, failed=()):
    failed = np.isin(np.arange(len(steps)), failed)
    return SimpleNamespace(steps=np.array(steps), failed=failed, done=False)


def test_numbers(tmp_path, clock):
    files = StatusFiles([tmp_path], 1000)
    clock.now = 110.0
    files.update([training(100, 100)])
    assert read_json(tmp_path / "status.json")["steps_per_second"] is None
    assert share_done(tmp_path) == 0.1
    clock.now = 120.0
    status.CLOCK.seconds = 5.0  # of these ten
    files.update([training(300, 300)])
    assert speed(tmp_path) == (600 - 200) / 5
    assert share_done(tmp_path) == 0.3
    clock.now = 120.9
    files.update([training(400, 400)])  # less than a second after the last
    assert share_done(tmp_path) == 0.3
    files.update([training(400, 1000)], last=True)
    assert share_done(tmp_path) == 0.4
    clock.now = 130.0
    files.update([training(600, 410, failed=[1])])
    assert share_done(tmp_path) == 0.6
    assert list(sessions(tmp_path).values()) == [30.0]


def test_a_process_has_one_id_in_all_folders_that_it_trained(tmp_path, clock):
    a, b, alone = (tmp_path / name for name in ("a", "b", "alone"))
    for folder in (a, b, alone):
        folder.mkdir()
    both = StatusFiles([a, b], 100)
    clock.now = 107.0
    both.update([training(50), training(60)], last=True)
    later = StatusFiles([a], 100)
    clock.now = 118.0
    later.update([training(100)], last=True)
    assert list(sessions(a).values()) == [7, 11]
    assert list(sessions(b).items()) == list(sessions(a).items())[:1]
    assert sessions(alone) == {}
    assert (share_done(a), share_done(b), share_done(alone)) == (1.0, 0.5, 0.0)


@pytest.mark.parametrize(
    "content",
    [
        "",
        "[]",
        "{}",
        '{"share": 1',
        '{"share": "1", "steps_per_second": null, "sessions": {}}',
        '{"share": 1.5, "steps_per_second": null, "sessions": {}}',
        '{"share": NaN, "steps_per_second": null, "sessions": {}}',
        '{"share": 0.5, "steps_per_second": [1], "sessions": {}}',
        '{"share": 0.5, "steps_per_second": null, "sessions": [1]}',
        '{"share": 0.5, "steps_per_second": null, "sessions": {"a": -1}}',
    ],
)
def test_a_file_of_another_form_says_nothing(tmp_path, content, clock):
    (tmp_path / "status.json").write_text(content)
    assert (share_done(tmp_path), speed(tmp_path)) == (0.0, None)
    assert sessions(tmp_path) == {}
    StatusFiles([tmp_path], 10).update([training(5)])
    assert share_done(tmp_path) == 0.5


def test_a_folder_of_an_earlier_version(tmp_path):
    """Its times are prose, which nothing reads."""
    (tmp_path / "timing.log").write_text("cpo x 1: 40 % after 3 s, 9 steps/s\n")
    assert (share_done(tmp_path), speed(tmp_path), sessions(tmp_path)) == (0, None, {})


def test_by_hand(tmp_path):
    write_status(tmp_path, 0.25, 34, one=3, other=4.5)
    assert (share_done(tmp_path), speed(tmp_path)) == (0.25, 34)
    assert sessions(tmp_path) == {"one": 3, "other": 4.5}
