"""Measures: user-defined ones, values that runs lack, means, and the tidy frame of all values."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from small_runs import cells, groups_of, lines_of, write_evaluated

from agents import presets, results
from agents.cli.main import main
from agents.errors import OwnCodeError
from agents.paper.evidence import gather
from agents.paper.grid import ablations
from agents.paper.sections import STUDY
from agents.reporting.compare import compare
from agents.reporting.provenance import summary
from agents.reporting.report import report, table
from agents.results.frame import COLUMNS, frame
from agents.results.measures import Measure, measure, measures, register, unregister
from agents.results.reading import read_groups
from agents.results.statistics import difference_of, mean_of, within_limit

SMALL = {"backend": "numpy", "random-steps": 40, "gradient-steps": 1, "batch-size": 32}


def worst_cost(run):
    """Return an eighth of the highest episode cost; None, as if unknown, where it is nine."""
    worst = float(run.records.cost.max())
    return None if worst == 9 else worst / 8


@pytest.fixture
def outside():
    """A user-defined measure, which the paper does not have, with its own title and digits."""
    register(Measure("worst_cost", "worst episode", "cost", 3, "lower", worst_cost))
    yield
    unregister("worst_cost")


def test_a_user_defined_measure_is_in_every_table_and_file(outside, tmp_path):
    a, b = tmp_path / "a", tmp_path / "b"
    write_evaluated(a / "trpo-lag", "trpo-lag", costs=(4, 5))
    values = ablations("trpo-lag", "Circle2D-1-v0")["sgd"]
    other = presets.preset_with("trpo-lag", "Circle2D-1-v0", values)
    write_evaluated(a / "sgd", "trpo-lag", costs=(6, 6), hyperparameters=other)
    write_evaluated(a / "cpo", "cpo", costs=(3, 3))
    write_evaluated(a / "wcsac", "wcsac", costs=(9, 9))
    write_evaluated(b, "trpo-lag", costs=(7, 7))
    report(a, study=STUDY)
    compare(a, b, tmp_path)
    head = "worst episode (cost)"
    tables, _, choices = (a / "report.md").read_text().partition("task, algorithm and choice")
    tables = tables.rpartition("\n")[0]
    of = rows(tables)
    assert of["TRPO-Lag, mean of 2"][head] == "0.562 range 0.500 to 0.625"
    assert of["CPO, mean of 2"][head] == "**0.375** range 0.375 to 0.375"
    of = rows("| task, algorithm and choice" + choices)
    name = "Circle2D-1-v0, TRPO-Lag, sgd, mean of 2"
    assert of[name][head] == "0.750 range 0.750 to 0.750"
    page = (a / "index.html").read_text()
    assert page.count(f'<th scope="col">{head}</th>') == 3  # means, runs and ablations
    assert '<td class="best">0.375<br><small>range 0.375 to 0.375</small></td>' in page
    of = rows((tmp_path / "compare.md").read_text())
    assert of["B - A: TRPO-Lag"][head] == "+0.312"
    assert head in (tmp_path / "compare.html").read_text()
    of = lines(tmp_path / "compare.csv")
    assert float(of["B - A: TRPO-Lag (100 steps)", "difference", ""]["worst_cost"]) == 0.3125
    of = lines(a / "report.csv")
    assert float(of["CPO (100 steps)", "run", "1"]["worst_cost"]) == 0.375
    # A value that runs lack is a dash in tables and empty in files of numbers.
    of_lacking = rows(tables)["WCSAC, mean of 2"]
    assert of_lacking[head] == "–"
    assert of_lacking["EMCC_0.33"] == "0.90 range 0.90 to 0.90"
    assert rows(tables)["TRPO-Lag, paper (3 seeds)"][head] == "–"
    for line in (of["WCSAC (100 steps)", "mean", ""], of["TRPO-Lag", "paper", ""]):
        assert line["worst_cost"] == ""


def rows(markdown):
    """Return the cells of the first table, by the row's name and the column's head."""
    head, *others = cells(markdown[markdown.index("| ") :].partition("\n\n")[0])
    return {row[0]: dict(zip(head, row, strict=True)) for row in others}


def lines(path):
    return {(x["algorithm"], x["kind"], x["seed"]): x for x in lines_of(path)}


def test_a_second_cost_has_rows_of_its_own_and_decides_no_claim(tmp_path, monkeypatch):
    task = "Circle2D-1-v0"
    write_evaluated(tmp_path / "two", "cpo", costs=(4, 4), second=(7, 8))
    monkeypatch.setitem(presets.PAPER_STEPS, task, 100)
    report(tmp_path, study=STUDY)
    table = rows((tmp_path / "report.md").read_text()[len("## The") :].partition(f"## {task}")[2])
    first, second = (table[f"CPO{of}, mean of 2"] for of in ("", " (cost_2)"))
    assert first["cost rate"].strip("*")[:4] == "0.40"
    assert second["cost rate"] == "0.75 range 0.70 to 0.80"
    assert (first["J_C"].strip("*")[:4], second["J_C"].strip("*")[:4]) == ("4.25", "8.50")
    assert first["within limit"] == "2 of 2 [0.16, 1.00]"
    assert second["within limit"] == "–"  # nothing limits it
    of = lines(tmp_path / "report.csv")
    rates = [float(of[f"CPO{k}", "run", "1"]["cost_rate"]) for k in ("", " (cost_2)")]
    assert rates == pytest.approx([0.4, 0.8])
    assert len([key for key in of if key[1] == "run"]) == 4
    both = groups_of(tmp_path / "two")
    assert [group.cost for group in both] == ["cost", "cost_2"]
    assert summary(both).startswith("2 runs, 1 task, 1 algorithm, ")
    assert not any("**" in cell for cell in second.values())  # no rival of the first
    assert len(gather(both)[task, "cpo"].runs) == 2
    assert gather(both[1:])[task, "cpo"].lacking == "no runs"


def test_a_mean_of_what_is_not_known_is_not_known():
    assert mean_of([1.0, None]) is None
    assert mean_of([]) is None
    assert difference_of([1.0, 2.0], [None]) is None
    found = difference_of([1.0, 2.0], [5.0, 5.0])
    assert (found.value, found.low, found.high) == (3.5, None, None)


@pytest.mark.parametrize(
    ("wrong", "error"), [(lambda run: [][0], IndexError), (lambda run: sys.exit(0), SystemExit)]
)
def test_a_measure_that_raises_is_named_and_the_run_is_not_blamed(tmp_path, wrong, error):
    write_evaluated(tmp_path / "cpo", "cpo", costs=(4, 4))
    register(Measure("mine", "mine", "", 2, "lower", wrong))
    try:
        with pytest.raises(
            OwnCodeError, match=r"'mine' failed on run .*cpo, Circle2D-1-v0, seed 0"
        ) as raised:
            report(tmp_path)
    finally:
        unregister("mine")
    assert isinstance(raised.value.__cause__, error)


@pytest.mark.parametrize("value", [1.2, -0.1, np.nan])
def test_a_measure_out_of_its_bounds_is_named(tmp_path, value):
    write_evaluated(tmp_path / "cpo", "cpo", costs=(4, 4))
    register(Measure("mine", "mine", "", 2, "lower", lambda run: value, bounds=(0.0, 1.0)))
    try:
        with pytest.raises(OwnCodeError, match=f"'mine' must .*number from 0 to 1.*got {value}"):
            report(tmp_path)
    finally:
        unregister("mine")
    assert not (tmp_path / "report.csv").exists()


@pytest.mark.parametrize("value", ["12", [1.0, 2.0], {}, float("nan"), -np.inf])
def test_a_measure_that_gives_no_number_is_named(tmp_path, value):
    write_evaluated(tmp_path / "cpo", "cpo", costs=(4, 4))
    register(Measure("mine", "mine", "", 2, "lower", lambda run: value))
    try:
        with pytest.raises(
            OwnCodeError, match=r"'mine' must return a finite number or None; for run .*seed 0"
        ):
            report(tmp_path)
    finally:
        unregister("mine")


def test_a_training_whose_table_fails_by_a_measure_ends_with_its_traceback(tmp_path, capsys):
    def broken(run):
        raise RuntimeError("mine alone")

    register(Measure("mine", "mine", "", 2, "lower", broken))
    given = [str(w) for k, v in (("hidden", 8), *SMALL.items()) for w in (f"--{k}", v)]
    try:
        command = ["train", "sac", "--steps", "50", "--seeds", "0", "--out", str(tmp_path / "a")]
        assert main([*command, *given]) == 1
    finally:
        unregister("mine")
    err = capsys.readouterr().err
    assert "in broken" in err and "RuntimeError: mine alone" in err
    assert err.splitlines()[-1].startswith("circle2d: no table: measure 'mine' failed on run")


def test_names_of_measures_are_different_and_single_words():
    with pytest.raises(ValueError, match="there is a measure 'J_R' already"):
        register(measure("J_R"))
    with pytest.raises(ValueError, match="must be one word, got 'a b'"):
        Measure("a b", "a", "", 2, "lower", lambda run: 0.0)
    assert len({of.name for of in measures()}) == len(measures())


def test_a_row_for_each_run_and_measure(tmp_path):
    """CPO has seeds 0 to 2 in a folder, 3 and 4 in another, and a run on another level."""
    write_evaluated(tmp_path / "a", "cpo", costs=(1, 2, 3))
    write_evaluated(tmp_path / "b", "cpo", costs=(4, 5), seeds=(3, 4))
    write_evaluated(tmp_path / "c", "wcsac", costs=(5, 6))
    write_evaluated(tmp_path / "d", "cpo", costs=(7,), task="Circle2D-2-v0")
    groups = read_groups([tmp_path], [])
    tidy = frame(groups)
    assert list(tidy.columns) == list(COLUMNS)
    assert len(tidy) == (5 + 2 + 1) * len(measures(shown=False))
    assert set(tidy["source"]) == {"runs"} and not tidy["failure"].any()
    assert [group.folder for group in groups] == ["a + b", "c", "d"]
    for number, group in enumerate(groups):
        for run in group.runs:
            rows = tidy[(tidy["group"] == number) & (tidy["seed"] == run.seed)]
            assert set(rows["task"]) == {group.task}
            assert set(rows["settings"]) == {"100 steps"}
            for row in rows.itertuples():
                name = row.measure if np.isnan(row.part) else f"{row.measure}_{row.part}"
                value = run.measures[name]
                assert row.value == value or (value is None and np.isnan(row.value))
    of_thirds = tidy["measure"].isin(["EMCC", "rate"])
    assert set(tidy.loc[of_thirds, "part"]) == {0.33, 0.66, 0.99}
    assert tidy.loc[~of_thirds, "part"].isna().all()
    assert set(tidy["name"]) == {"CPO (100 steps)", "WCSAC (100 steps)"}
    table(tmp_path)
    for line, row in zip(lines_of(tmp_path / "measures.csv"), tidy.itertuples(), strict=True):
        assert line["measure"] == row.measure and int(line["seed"]) == row.seed
        for name in ("part", "value"):
            assert float(line[name] or "nan") == pytest.approx(
                getattr(row, name), 0, 0, nan_ok=True
            )


def test_a_frame_has_printed_numbers_windows_and_failures(tmp_path):
    write_evaluated(tmp_path / "a", "cpo", costs=(1, 2))
    path = tmp_path / "a" / "results.npz"
    with np.load(path) as file:
        arrays = dict(file)
    arrays["Circle2D-1-v0/1/failure"] = np.array("it fell")
    np.savez(path, **arrays)

    def printed(group):
        return replace(group, printed={"J_C": 7.0}, publication="book (9 seeds)")

    tidy = results.read([tmp_path], window=2, printed=printed)
    runs, book = tidy[tidy["source"] == "runs"], tidy[tidy["source"] == "book (9 seeds)"]
    assert book[["measure", "value"]].to_numpy().tolist() == [["J_C", 7.0]]
    fallen = runs[runs["seed"] == 1]
    assert set(fallen["failure"]) == {"it fell"} and fallen["value"].isna().all()
    whole = runs[runs["seed"] == 0]
    assert not whole["failure"].any() and set(whole["steps"]) == {100}
    assert (whole["window"] == 2).equals(whole["part"].notna())


def test_a_cost_at_the_limit_is_within(tmp_path):
    """A J_C of 5 is within the limit of 5, one of 5.01 is not."""
    write_evaluated(tmp_path / "a", "cpo", costs=(4, 4), evaluated=((5.0,), (5.01,)))
    share = within_limit(groups_of(tmp_path / "a")[0])
    assert (share.count, share.runs) == (1, 2)
