"""Runs in a folder: what a report says about those that it cannot read."""

from pathlib import Path

import pytest
from small_runs import write_evaluated

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
