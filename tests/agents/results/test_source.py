"""Runs in a folder: what a report says about those that it cannot read."""

from pathlib import Path

import gymnasium as gym
import pytest
from small_runs import write_evaluated
from toys import Walk

from agents.paper.presets import preset
from agents.reporting.report import report
from agents.reporting.table import markdown
from agents.results.reading import read_groups
from agents.results.source import FolderSource


@pytest.mark.parametrize("given", [".", "../runs", "../r", "{here}"])
def test_messages_name_the_folder_however_it_is_given(tmp_path, monkeypatch, given):
    folder = tmp_path / "runs"
    write_evaluated(folder, "sac-lag", [2, 4])
    (folder / "seed-1" / "evaluation.json").unlink()
    (folder / "broken").mkdir()
    (folder / "broken" / "config.json").write_text("{")
    (tmp_path / "r").symlink_to(folder)
    monkeypatch.chdir(folder)
    notes = []
    read_groups(FolderSource(Path(given.format(here=folder))), notes)
    assert notes == [
        "left out: runs/broken/config.json is damaged: "
        "Expecting property name enclosed in double quotes: line 1 column 2 (char 1)",
        "left out: runs/seed-1: runs/seed-1/evaluation.json is missing: "
        "not a run folder, or a damaged one",
    ]


@pytest.fixture
def licences():
    """Those left for the task Mine-v0: each environment uses one up."""
    left = [None] * 5

    def mine(**kwargs):
        if not left:
            raise RuntimeError("no licence")
        left.pop()
        return Walk(**kwargs)

    gym.register("Mine-v0", mine, disable_env_checker=True)
    yield left
    del gym.registry["Mine-v0"]


def test_complete_runs_are_reported_where_their_task_cannot_be_made(tmp_path, licences):
    folder = tmp_path / "runs"
    hyperparameters = preset("sac-lag", "Circle2D-1-v0")
    write_evaluated(folder, "sac-lag", [2, 4], hyperparameters, task="Mine-v0")
    licences.clear()
    archive = tmp_path / "packed.zip"
    words = markdown(report(folder, archive=archive).blocks)
    [row] = [line for line in words.splitlines() if "mean of 2" in line]
    assert "0.30 range 0.20 to 0.40" in row  # the cost rate of steps: 2 and 4 of 10
    note = "Note: no pictures of Mine-v0: cannot make task 'Mine-v0': no licence"
    assert words.count(note) == 1
    assert "left out" not in words
    report(archive)
    for name in ("report.md", "index.html"):
        assert (tmp_path / "packed" / name).read_bytes() == (folder / name).read_bytes()
