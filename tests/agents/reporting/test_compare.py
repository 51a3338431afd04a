"""Comparisons of two sets of runs, from files written by hand."""

import math
import re

import numpy as np
import pytest
import scipy.stats
from small_runs import cells, chain, lines_of, write_evaluated

import agents
from agents.cli.main import main
from agents.reporting.compare import compare
from agents.reporting.table import markdown

RIM = [[[1.0, 0.0]]]
"""The right rim."""


def write_runs(folder, name, j_r, task="Circle2D-1-v0", streak=4):
    """Write a run for each return, with ten episodes of ten steps of which four cost."""
    episode = [*chain(streak, 9), 1.0] if streak < 4 else chain(4, 10)
    costs = [episode * 10 for _ in j_r]
    write_evaluated(folder, name, costs, task=task, returns=j_r, at=RIM)
    return folder


def rows(words):
    """Return the cells by the row's name, without the number of tests that p is corrected for."""
    words = re.sub(r"p, corrected for \d+ \(Holm\)", "p", words)
    return {row[0]: row[1:] for row in cells(words)}


def test_two_seeds_against_two_by_hand(tmp_path):
    a = write_runs(tmp_path / "a", "trpo-lag", [-10.0, -20.0])
    b = write_runs(tmp_path / "b", "cpo", [-5.0, -9.0], streak=3)
    words = markdown(compare(a, b))
    found = rows(words)
    assert found["A: TRPO-Lag, mean of 2"][4] == "-15.00 range -20.00 to -10.00"
    assert found["B: CPO, mean of 2"][4] == "-7.00 range -9.00 to -5.00"
    assert found["A: TRPO-Lag, mean of 2"][8] == "2 of 2 [0.16, 1.00]"  # 4.25 is within 5
    assert found["B - A: CPO - TRPO-Lag"][4] == "+8.00"
    assert found["B - A: CPO - TRPO-Lag"][0] == "-0.10"
    # Two of the six permutations are as extreme as the runs, or all where the values are equal.
    assert found["p"][:6] == ["1.000"] * 6
    assert found["P(B better)"][:6] == [*["1.00"] * 3, "0.50", "1.00", "0.50"]
    numbers = ("0.40", "0.40", "0.40", "0.40", "-20.00", "4.25", "4.25", "4.00")
    assert found["A: TRPO-Lag, seed 1"] == [*numbers, "1 of 1", "right rim"]
    assert "corrected for the 8 comparisons made here (Holm)" in words
    assert rows(markdown(compare(b, a)))["B - A: TRPO-Lag - CPO"][4] == "-8.00"


def test_five_seeds_have_intervals_and_tests(tmp_path):
    """J_R is -100 plus 1, 2, ... 5 against -100 plus 2, 4, ... 10: the means differ by 3, the
    variances are 2.5 and 10.

    Welch's t interval: 3 ± t √(2.5/5 + 10/5), with 2.5² / (.5²/4 + 2²/4) = 5.88 degrees of freedom.
    """
    first = [k - 100.0 for k in range(1, 6)]
    second = [2 * k - 100.0 for k in range(1, 6)]
    a = write_runs(tmp_path / "a", "cpo", first)
    b = write_runs(tmp_path / "b", "trpo-lag", second)
    out = tmp_path / "out"
    found = rows(markdown(compare(a, b, out)))
    name = "B - A: TRPO-Lag - CPO"
    half = scipy.stats.t.ppf(0.975, 2.5**2 / (0.5**2 / 4 + 2**2 / 4)) * math.sqrt(2.5)
    assert found[name][4] == f"+3.00 [{3 - half:+.2f}, {3 + half:+.2f}]"
    expected = scipy.stats.permutation_test(
        (first, second),
        lambda x, y, axis: np.abs(scipy.stats.ttest_ind(x, y, axis=axis, equal_var=False)[0]),
        permutation_type="independent",
        n_resamples=np.inf,
        alternative="greater",
    ).pvalue
    (line,) = (x for x in lines_of(out / "compare.csv") if x["kind"] == "p")
    assert float(line["J_R"]) == pytest.approx(expected)
    # All other measures are equal: p = 1, and Holm multiplies the smallest of eight by 8.
    assert float(found["p"][4]) == pytest.approx(min(1, 8 * expected), abs=0.0006)
    words = agents.compare(a, b)
    assert "| p, corrected for 8 (Holm) " in words
    # If it is the only measure asked for, p is not corrected; with two measures it is doubled.
    for asked, factor in (("J_R", 1), (["J_R", "J_C"], 2)):
        words = agents.compare(a, b, tmp_path / "asked", measures=asked)
        assert float(rows(words)["p"][4]) == pytest.approx(factor * expected, abs=0.0006)
        assert [cell for cell in rows(words)["p"] if cell not in ("", "\N{EN DASH}")][factor:] == []
        assert ("Holm" in words) == (factor > 1)
    (line,) = (x for x in lines_of(tmp_path / "asked" / "compare.csv") if x["kind"] == "p")
    assert float(line["J_R"]) == pytest.approx(expected) and line["EMCC_0.33"] == ""
    with pytest.raises(agents.UserError, match="no measure 'J_r': did you mean 'J_R'"):
        agents.compare(a, b, measures="J_r")
    half = scipy.stats.t.ppf(0.975, 4) * math.sqrt(2.5 / 5)
    assert found["A: CPO, mean of 5"][4] == f"-97.00 [{-97 - half:.2f}, {-97 + half:.2f}]"
    pairs = [(y > x) + (y == x) / 2 for x in first for y in second]
    assert found["P(B better)"][4].startswith(f"{sum(pairs) / 25:.2f} [")
    middle = next(
        x for x in lines_of(out / "compare.csv") if (x["algorithm"][:1], x["kind"]) == ("B", "iqm")
    )
    assert float(middle["J_R"]) == -94  # the mean of the middle three of five


def test_runs_too_few_for_a_test_are_named(tmp_path):
    """For completely separated runs the least p is 2 / 20 with 3 runs against 3 and 1 / 35 with 3
    against 4, times the number of measures. With 6 against 6, 2 / 924, p can be below .05."""
    a = write_runs(tmp_path / "a", "cpo", [-10.0, -11.0, -12.0])
    for runs, ways in ((3, 10), (4, 35)):
        b = write_runs(tmp_path / f"b{runs}", "cpo", [-1.0 - k / 10 for k in range(runs)])
        words = markdown(compare(a, b))
        tests = sum(cell not in ("", "–") for cell in rows(words)["p"])
        p = float(rows(words)["p"][4])
        assert p == pytest.approx(min(1, tests / ways), abs=0.001)
        assert f"with 3 runs against {runs}, no p here can be below {tests / ways:.3g}, " in words
    sides = [tmp_path / name for name in "cd"]
    for side, j in zip(sides, (-1.0, -9.0), strict=True):
        write_runs(side, "cpo", [j - x / 10 for x in range(6)])
    assert "tests decide nothing" not in markdown(compare(*sides))


def test_over_tasks_few_runs_decide(tmp_path):
    """Three runs on each side, with streaks of 4 and 3 of 10 steps, on two tasks.

    In every run of B every EMCC is lower by .1: of 20² permutations within the tasks the observed
    one and its opposite are the most extreme. Cost rates are equal. Holm's factors are 4, ... 1.
    """
    for side, name, streak in (("a", "trpo-lag", 4), ("b", "cpo", 3)):
        for level in (1, 2):
            folder = tmp_path / side / str(level)
            write_runs(folder, name, [-1.0, -2.0, -3.0], f"Circle2D-{level}-v0", streak=streak)
    out = tmp_path / "out"
    tables = compare(tmp_path / "a", tmp_path / "b", out)
    assert len(tables) == 3
    name = "B - A: CPO - TRPO-Lag"
    difference, p, better = tables[-1].rows
    assert tables[-1].head[1:] == ["EMCC_0.33", "EMCC_0.66", "EMCC_0.99", "cost rate"]
    names = [f"{name}, 2 tasks, 3 seeds against 3", "p, corrected for 4 (Holm)", "P(B better)"]
    assert [row.name for row in tables[-1].rows] == names
    assert [n.value for n in difference.numbers] == pytest.approx([-0.1, -0.1, -0.1, 0])
    assert all(n.low is None for n in difference.numbers)  # fewer than five seeds
    assert [n.value for n in p.numbers] == pytest.approx([*[4 * 2 / 400] * 3, 1])
    assert [n.value for n in better.numbers] == [1, 1, 1, 0.5]
    assert "corrected for the 4 comparisons of this table (Holm)" in tables[-1].caption
    found = {
        (x["kind"], x["EMCC_0.33"]) for x in lines_of(out / "compare.csv") if x["task"] == "2 tasks"
    }
    assert {kind for kind, _ in found} == {"difference", "p", "improvement"}
    assert 2 / 400 in [pytest.approx(float(value)) for kind, value in found if kind == "p"]
    assert "All tasks together" in (out / "compare.html").read_text()
    assert markdown(tables) == (out / "compare.md").read_text()


def test_the_command_prints_the_tables_and_writes_files_where_asked(tmp_path, capsys):
    a = write_runs(tmp_path / "a", "cpo", [-10.0, -20.0])
    b = write_runs(tmp_path / "b", "cpo", [-5.0, -9.0])
    before = sorted(tmp_path.rglob("*"))
    assert main(["compare", str(a), str(b)]) == 0
    printed = capsys.readouterr().out
    assert sorted(tmp_path.rglob("*")) == before
    out = tmp_path / "new" / "out"
    assert main(["compare", str(a), str(b), "--out", str(out)]) == 0
    assert capsys.readouterr().out == printed
    assert (out / "compare.md").read_text() + "\n" == printed
    kinds = ("mean", "mean lowest", "mean highest", "iqm", "run", "run")
    numbers = {"A": (-15, -20, -10, -15, -10, -20), "B": (-7, -9, -5, -7, -5, -9)}
    expected = [(of, *pair) for of, own in numbers.items() for pair in zip(kinds, own, strict=True)]
    expected += [("B", "difference", 8), ("B", "p", pytest.approx(1 / 3)), ("B", "improvement", 1)]
    told = [x for x in lines_of(out / "compare.csv") if x["J_R"]]
    assert [(x["algorithm"][0], x["kind"], float(x["J_R"])) for x in told] == expected
    shares = [x for x in lines_of(out / "compare.csv") if x["share"]]
    names = ("algorithm", "kind", "ends_in", "seeds", "share")
    assert [tuple(x[name] for name in names) for x in shares] == [
        (f"{side}: CPO (100 steps)", *of, "2", "1.0")
        for side in "AB"
        for of in (("ends in", "right rim"), ("within limit", ""))
    ]
    assert [float(x["share_low"]) for x in shares] == pytest.approx([math.sqrt(0.025)] * 4)
    first = {path.name: path.read_bytes() for path in out.iterdir()}
    assert main(["compare", str(a), str(b), "--out", str(out)]) == 0
    assert {path.name: path.read_bytes() for path in out.iterdir()} == first
    assert main(["compare", str(a), str(b), "--measure", "J_C", "J_R"]) == 0
    assert "| p, corrected for 2 (Holm) " in capsys.readouterr().out.replace(printed, "")


def test_over_tasks_only_seeds_of_every_task_count(tmp_path):
    """Task 1 has seeds 0 to 2, task 2 seeds 0 and 1: the last run of task 1 is not used."""
    for side, name, streak in (("a", "trpo-lag", 4), ("b", "cpo", 3)):
        write_runs(tmp_path / side / "1", name, [0.0, 0.0, 0.0], streak=streak)
        write_runs(tmp_path / side / "2", name, [0.0, 0.0], "Circle2D-2-v0", streak=streak)
    difference, p, _ = compare(tmp_path / "a", tmp_path / "b")[-1].rows
    assert difference.name.endswith("2 tasks, 2 seeds against 2")
    assert p.numbers[0].value == pytest.approx(4 * 2 / 6**2)
    # One seed on a task allows no test.
    write_runs(tmp_path / "a" / "3", "trpo-lag", [0.0], "Circle2D-3-v0")
    write_runs(tmp_path / "b" / "3", "cpo", [0.0], "Circle2D-3-v0")
    assert len(compare(tmp_path / "a", tmp_path / "b")) == 3


def test_each_cost_is_compared_with_itself(tmp_path):
    """In A's runs 2 and 4 of 10 steps cost, for the second cost 6 and 8; in B's one fewer."""
    for side, first, second in (("a", (2, 4), (6, 8)), ("b", (1, 3), (5, 7))):
        write_evaluated(tmp_path / side, "cpo", first, second=second)
    found = rows(markdown(compare(tmp_path / "a", tmp_path / "b")))
    gaps = {name: own[3] for name, own in found.items() if name.startswith("B - A")}
    assert list(gaps.values()) == ["-0.10", "-0.10"]
