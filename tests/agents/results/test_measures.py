"""A measure from outside, and measures that runs lack, in everything that a report writes."""

import csv
import html
import json

import numpy as np
import pytest
from small_runs import write_evaluated

from agents.paper.presets import ablations
from agents.reporting.compare import compare
from agents.reporting.report import report
from agents.reporting.table import markdown
from agents.results.measures import (
    Measure,
    MeasureFailure,
    RunData,
    measure,
    measures,
    register,
    unregister,
)
from agents.results.statistics import difference_of, mean_of
from emcc import EpisodeRecords


def worst_cost(run):
    """Known of runs that recorded cost steps alone, so that old ones lack it."""
    return None if run.records.cost_steps is None else float(run.records.cost.max()) / 8


@pytest.fixture
def outside():
    """A measure that the paper lacks, with a title and digits of its own."""
    register(Measure("worst_cost", "worst episode", "cost", 3, "lower", worst_cost))
    yield
    unregister("worst_cost")


def test_a_measure_from_outside_is_everywhere(outside, tmp_path):
    a, b = tmp_path / "a", tmp_path / "b"
    write_evaluated(a / "trpo-lag", "trpo-lag", costs=(4, 5))
    other = ablations("trpo-lag", "Circle2D-1-v0")["sgd"]
    write_evaluated(a / "sgd", "trpo-lag", costs=(6, 6), hyperparameters=other)
    write_evaluated(a / "cpo", "cpo", costs=(3, 3))
    write_evaluated(a / "wcsac", "wcsac", costs=(5, 5), old=True)
    write_evaluated(b, "trpo-lag", costs=(7, 7))
    report(a)
    compare(a, b, tmp_path)
    head = "worst episode (cost)"
    tables, _, choices = (a / "report.md").read_text().partition("task, algorithm and choice")
    tables = tables.rpartition("\n")[0]
    of = rows(tables)
    assert of["TRPO-Lag (100 steps), mean of 2"][head] == "0.562 range 0.500 to 0.625"
    assert of["CPO (100 steps), mean of 2"][head] == "**0.375** range 0.375 to 0.375"
    assert of["CPO (100 steps), seed 0"][head] == "0.375"
    assert "the lowest EMCC, cost rate and worst episode; J_R, J_C and CVaR of" in tables
    of = rows("| task, algorithm and choice" + choices)
    assert (
        of["Circle2D-1-v0, TRPO-Lag, sgd, 100 steps, mean of 2"][head]
        == "0.750 range 0.750 to 0.750"
    )
    page = (a / "index.html").read_text()
    assert page.count(f'<th scope="col">{head}</th>') == 3  # means, runs and ablations
    assert '<td class="best">0.375<br><small>range 0.375 to 0.375</small></td>' in page
    of = rows((tmp_path / "compare.md").read_text())
    assert of["B - A: TRPO-Lag (100 steps)"][head] == "+0.312"
    assert head in (tmp_path / "compare.html").read_text()
    of = lines(tmp_path / "compare.csv")
    assert float(of["B - A: TRPO-Lag (100 steps)", "difference", ""]["worst_cost"]) == 0.3125
    of = lines(a / "report.csv")
    assert float(of["CPO (100 steps)", "run", "1"]["worst_cost"]) == 0.375
    # What old runs lack is a dash, and empty for a program.
    of_old = rows(tables)["WCSAC (100 steps), mean of 2"]
    assert (of_old[head], of_old["mean streak (steps)"]) == ("–", "–")
    assert of_old["EMCC_0.33"] == "0.50 range 0.50 to 0.50"
    assert rows(tables)["TRPO-Lag, paper (3 seeds)"][head] == "–"
    for line in (of["WCSAC (100 steps)", "mean", ""], of["TRPO-Lag", "paper", ""]):
        assert (line["worst_cost"], line["mean_streak"]) == ("", "")


def rows(markdown):
    """Cells of the first table by the name of the row and the head of the column."""
    lines = markdown[markdown.index("| ") :].partition("\n\n")[0].splitlines()
    table = [line.split("|")[1:-1] for line in lines if line.startswith("|")]
    head, _, *others = ([cell.strip() for cell in line] for line in table)
    return {row[0]: dict(zip(head, row, strict=True)) for row in others}


def lines(path):
    with path.open(newline="") as file:
        return {(x["algorithm"], x["kind"], x["seed"]): x for x in csv.DictReader(file)}


def test_an_evaluation_without_a_measure(tmp_path):
    write_evaluated(tmp_path / "cpo", "cpo", costs=(4, 4))
    path = tmp_path / "cpo" / "seed-1" / "evaluation.json"
    content = json.loads(path.read_text())
    del content["deterministic"]["CVaR_0.5"]
    path.write_text(json.dumps(content))
    of = rows(markdown(report(tmp_path).blocks))
    assert of["CPO (100 steps), mean of 2"]["CVaR_0.5"] == "–"
    assert of["CPO (100 steps), seed 0"]["CVaR_0.5"] == "6.50"
    assert of["CPO (100 steps), seed 1"]["CVaR_0.5"] == "–"
    assert ">–</td>" in html.unescape((tmp_path / "index.html").read_text())
    content["deterministic"]["J_R"] = float("nan")
    path.write_text(json.dumps(content))
    assert "cpo/seed-1: J_R is not finite: nan" in markdown(report(tmp_path).blocks)


def test_the_mean_streak_by_hand():
    """Chains of 4, 2, 1 and 1 cost steps: 8 steps in 4 chains."""
    zero = np.zeros(3)
    records = EpisodeRecords(
        [0, 1, 2], [0, 10, 20], zero + 10, zero, [6, 2, 0], [4, 1, 0], [6, 2, 0], [2, 2, 0]
    )
    assert measure("mean_streak").compute(RunData(records, 30, {})) == 2.0
    safe = EpisodeRecords([0], [0], [10], [0], [0], [0], [0], [0])
    assert measure("mean_streak").compute(RunData(safe, 10, {})) == 0.0


def test_names_are_single_and_single_words():
    with pytest.raises(ValueError, match="there is a measure 'J_R' already"):
        register(measure("J_R"))
    with pytest.raises(ValueError, match="must be one word, got 'a b'"):
        Measure("a b", "a", "", 2, "lower", lambda run: 0.0)
    assert len({of.name for of in measures()}) == len(measures())


def test_a_mean_of_what_is_not_known_is_not_known():
    assert mean_of([1.0, None]) is None
    assert mean_of([]) is None
    assert difference_of([1.0, 2.0], [None]) is None
    found = difference_of([1.0, 2.0], [5.0, 5.0])
    assert (found.value, found.low, found.high) == (3.5, None, None)


def test_a_measure_that_raises_is_named_and_the_run_is_not_blamed(tmp_path):
    write_evaluated(tmp_path / "cpo", "cpo", costs=(4, 4))
    register(Measure("mine", "mine", "", 2, "lower", lambda run: [][0]))
    try:
        with pytest.raises(MeasureFailure, match=r"'mine' failed on run .*cpo/seed-0") as raised:
            report(tmp_path)
    finally:
        unregister("mine")
    assert isinstance(raised.value.__cause__, IndexError)
    assert not (tmp_path / "report.csv").exists()
