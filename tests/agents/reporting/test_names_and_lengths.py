"""Names of groups: settings of many values, numbers of steps, their order; lengths of episodes."""

import re

import numpy as np
import pytest
from small_runs import cells, edit_results, evaluate, lines_of, write_evaluated, write_runs

from agents import plot
from agents.presets import preset_with
from agents.reporting.compare import compare
from agents.reporting.report import report
from agents.reporting.table import markdown
from agents.results.names import setting

TASK = "Circle2D-1-v0"


def test_a_setting_of_many_values_is_counted_in_names(tmp_path):
    sizes = (8,) * 60
    own = preset_with("cpo", TASK, {"hidden": sizes, "input_scale": (2.0, 3.0)})
    write_evaluated(tmp_path / "a", "cpo", (2, 3), own)
    write_evaluated(tmp_path / "b", "cpo", (2, 3))
    report(tmp_path)
    names = {line["algorithm"] for line in lines_of(tmp_path / "report.csv")}
    assert any("hidden [60]" in name and "input_scale (2.0, 3.0)" in name for name in names)
    assert not any(str(sizes) in name for name in names)
    told = markdown(compare(tmp_path / "a", tmp_path / "b"))
    for words in ((tmp_path / "report.md").read_text(), told):
        (line,) = [line for line in words.splitlines() if str(sizes) in line]
        assert not line.startswith("|")
        assert "hidden of CPO (" in line


def test_a_long_text_is_counted_too():
    assert setting("xml", "<mujoco>" * 6) == "xml [48 characters]"
    assert setting("xml", "<mujoco>" * 5) == "xml " + "<mujoco>" * 5


@pytest.mark.parametrize("early", [True, False])
def test_lengths_are_shown_where_they_differ(tmp_path, early):
    """Episodes of 3 and 4 steps beside episodes of 10."""
    write_evaluated(tmp_path / "a", "cpo", (2, 3), evaluated=((3.0, 4.0),))
    write_evaluated(tmp_path / "b", "trpo-lag", (2, 3), evaluated=((3.0, 4.0),))
    if early:
        prefix = f"{TASK}__{{}}__evaluation__deterministic__lengths"
        edit_results(tmp_path / "a", **{prefix.format(k): np.array([3, 4]) for k in (0, 1)})
    report(tmp_path)
    told = markdown(compare(tmp_path / "a", tmp_path / "b"))
    for words in ((tmp_path / "report.md").read_text(), told):
        head, *rows = [row for row in cells(words) if len(row) > 8][:20]
        assert ("length (steps)" in head) == early
        if early:
            at = head.index("length (steps)")
            found = {row[0].removeprefix("A: ").removeprefix("B: "): row[at] for row in rows}
            assert found["CPO, seed 0"] == "3.5"
            assert found["CPO, mean of 2"].startswith("3.5")
            assert found["TRPO-Lag, seed 1"] == "10.0"


@pytest.mark.parametrize("differ", [True, False])
def test_names_have_the_number_of_steps_only_where_it_differs(tmp_path, differ):
    """A number that all runs on a task have is in the caption; files of numbers always have it."""
    write_evaluated(tmp_path / "a", "cpo", (2, 3))
    if differ:
        write_runs(tmp_path / "b", task=TASK)
        evaluate(tmp_path / "b")
    else:
        write_evaluated(tmp_path / "b", "sac-lag", (2, 3))
    report(tmp_path)
    plot(tmp_path, out=tmp_path / "curves.svg")
    names = ["CPO (100 steps)", "SAC-Lag (120 steps)"] if differ else ["CPO", "SAC-Lag"]
    told = (tmp_path / "report.md").read_text()
    means = [row[0] for row in cells(told) if row[0].endswith(", mean of 2")][:2]
    assert means == [f"{name}, mean of 2" for name in names]
    assert (told.count("trainings of 100 steps; "), told.count("(100 steps)") > 0) == (
        (0, True) if differ else (1, False)
    )
    shown = (tmp_path / "curves.svg").read_text()
    assert all(f">{name}</text>" in shown for name in names)
    written = {line["algorithm"] for line in lines_of(tmp_path / "report.csv")}
    assert "CPO (100 steps)" in written


@pytest.mark.parametrize("one_by_one", [True, False])
def test_folders_that_are_given_one_by_one_keep_their_order(tmp_path, one_by_one):
    """Folders below a given one are ordered by their algorithms."""
    given = ["wcsac", "cpo", "trpo-lag"]
    folders = [tmp_path / "runs" / name for name in given]
    for folder in folders:
        write_evaluated(folder, folder.name, (2, 3))
    shown = folders if one_by_one else [tmp_path / "runs"]
    tables = report(*shown, out=tmp_path / "out").blocks
    plot(*shown, out=tmp_path / "curves.svg")
    expected = ["WCSAC", "CPO", "TRPO-Lag"] if one_by_one else ["TRPO-Lag", "CPO", "WCSAC"]
    means = [row[0] for row in cells(markdown(tables)) if row[0].endswith(", mean of 2")]
    assert means == [f"{name}, mean of 2" for name in expected]
    legend = re.findall(r">([\w-]+)</text>", (tmp_path / "curves.svg").read_text())
    assert [name for name in legend if name in expected] == expected
