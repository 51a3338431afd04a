"""Seeds that were trained later, in a folder of their own, count with those before."""

import csv
import re
from dataclasses import replace

import pytest
from small_runs import write_evaluated

import agents
from agents.paper.presets import preset
from agents.reporting.compare import compare

TASK = "Circle2D-1-v0"


def rows(folder):
    """Of `report.csv`, without the names of folders."""
    with (folder / "report.csv").open() as file:
        return [{k: v for k, v in row.items() if k != "folder"} for row in csv.DictReader(file)]


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """Three runs of one training, and the same three of two: a run is the same in any company."""
    root = tmp_path_factory.mktemp("pooled")
    for name, seeds in (("whole", (0, 1, 2)), ("first", (0, 1)), ("later", (2,))):
        agents.train("trpo-lag", TASK, seeds=seeds, steps=2500, out=root / name)
    return root


def test_the_report_is_that_of_one_training(trained, tmp_path):
    agents.report(trained / "first", trained / "later", out=tmp_path / "both")
    agents.report(trained / "whole", out=tmp_path / "whole")
    assert rows(tmp_path / "both") == rows(tmp_path / "whole")
    pages = [(tmp_path / of / "index.html").read_text() for of in ("both", "whole")]
    # Visited states, trained paths and curves; the replay.
    for what in ('data:image/png;base64,[^"]+', "<svg.*?</svg>", 'id="replay-data">.*?</script>'):
        both, whole = (re.findall(what, page, re.DOTALL) for page in pages)
        assert both and both == whole


def test_it_is_told_and_an_archive_keeps_the_folders(trained, tmp_path):
    packed = tmp_path / "both.zip"
    agents.report(trained / "first", trained / "later", out=tmp_path / "all", archive=packed)
    words = "of equal settings, with other seeds, so counted as one"
    told = f"{words}: all/first (seeds 0, 1); all/later (seeds 2)"
    assert told in (tmp_path / "all" / "report.md").read_text()
    page = (tmp_path / "all" / "index.html").read_text()
    for folder, seeds in (("first", "0 1"), ("later", "2")):  # the commands that made them
        assert re.search(rf"--seeds {seeds} .*--out all/{folder}\b", page)
    agents.report(packed, out=tmp_path / "again")
    assert rows(tmp_path / "again") == rows(tmp_path / "all")


def with_seeds(folder, name, seeds, hyperparameters=None):
    """Evaluated runs, each with its seed as the number of cost steps."""
    write_evaluated(folder, name, seeds, hyperparameters, seeds=seeds)


def means(folder):
    agents.report(folder)
    return [row["algorithm"] for row in rows(folder) if row["kind"] == "mean"]


def test_a_seed_that_was_trained_twice_keeps_folders_apart(tmp_path):
    for name, seeds in (("a", (0, 1)), ("b", (2, 3)), ("c", (3, 4))):
        with_seeds(tmp_path / name, "cpo", seeds)
    here = tmp_path.name
    assert means(tmp_path) == [f"CPO (100 steps, in {here}/{k})" for k in "abc"]


def test_other_settings_stay_apart(tmp_path):
    usual = preset("trpo-lag", TASK)
    with_seeds(tmp_path / "a", "trpo-lag", (0, 1), usual)
    with_seeds(tmp_path / "b", "trpo-lag", (2, 3), replace(usual, discount=0.9))
    with_seeds(tmp_path / "c", "cpo", (2, 3))
    first = "TRPO-Lag (100 steps)"
    assert means(tmp_path) == [first, "TRPO-Lag (discount 0.9, 100 steps)", "CPO (100 steps)"]


def test_a_comparison_counts_them_as_one(tmp_path):
    """Means by hand: of ten steps the seeds cost, 1 to 5 of A, 6 to 10 of B."""
    for side, first in (("a", 1), ("b", 6)):
        for name, seeds in (("one", range(first, first + 2)), ("two", range(first + 2, first + 5))):
            with_seeds(tmp_path / side / name, "cpo", tuple(seeds))
    compare(tmp_path / "a", tmp_path / "b", out=tmp_path / "c")
    with (tmp_path / "c" / "compare.csv").open() as file:
        found = {(r["algorithm"], r["kind"]): r["cost_rate"] for r in csv.DictReader(file)}
    name = "CPO (100 steps)"
    assert float(found[f"A: {name}", "mean"]) == pytest.approx(0.3)
    assert float(found[f"B: {name}", "mean"]) == pytest.approx(0.8)
