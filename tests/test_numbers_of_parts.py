"""Numbers of the pages on SAC-LB-Streak's parts and on units of length are those of the reports."""

import csv
import functools
from pathlib import Path

import numpy as np
import results_table
import scipy.stats

FOLDER = Path(__file__).parents[1] / "results"
RESULTS = (FOLDER / "README.md").read_text()
SOLVE = (FOLDER / "solve" / "README.md").read_text()


@functools.cache
def runs(report):
    """The rows of single runs of a `report.csv`."""
    with report.open() as file:
        return [row for row in csv.DictReader(file) if row["seed"]]


def test_units_of_length_in_the_sac_family():
    """Where runs end behind the sentences of the page; the table is tested elsewhere."""

    def of(choice, levels=(1, 2, 3)):
        folders = {f"Circle2D-{level}-v0/{choice}" for level in levels}
        return [row for row in runs(results_table.REPORT) if row["folder"] in folders]

    def in_corridor(choice):
        return [row for row in of(choice) if row["ends_in"].startswith("corridor")]

    for choice, count, lowest in (("units", (9, 8), 9.5), ("bootstrap-units", (6, 7), 8.0)):
        there = [in_corridor(f"{name}-{choice}") for name in ("sac-lag", "wcsac")]
        assert tuple(map(len, there)) == count
        costs = [float(row["J_C"]) for rows in there for row in rows]
        assert lowest <= min(costs) < lowest + 0.5
        assert all("through" in row["ends_in"] for rows in there for row in rows)
    solved = {
        choice: sum(map(results_table.solves, of(f"sac-lb{choice}")))
        for choice in ("", "-units", "-bootstrap-units")
    }
    assert solved == {"": 11, "-units": 9, "-bootstrap-units": 3}
    assert (len(of("sac-lb")), len(of("sac-lb-units"))) == (30, 9)
    for table, p in (([[9, 0], [11, 19]], 0.001), ([[9, 0], [3, 6]], 0.009)):
        assert round(scipy.stats.fisher_exact(table).pvalue, 3) == p
    others = [r for r in of("sac-lb-bootstrap-units") if not results_table.solves(r)]
    assert sorted(row["ends_in"] for row in others) == ["cost region", *["right rim"] * 5]


def test_the_parts_of_sac_lb_streak():
    table = results_table.parts(results_table.SOLVED)
    assert len(table) == 4 * (1 + len(results_table.PARTS))
    tests = results_table.parts_over_levels(results_table.SOLVED)
    assert len(tests) == 8  # and the margin
    assert all(row in SOLVE for row in [*table, *tests])
    solved, others = {}, {}
    for level in range(4):
        for part in results_table.PARTS:
            folder = f"Circle2D-{level}-v0-sac-lb-streak-without-{part}"
            own = [row for row in runs(results_table.SOLVED) if row["folder"] == folder]
            assert len(own) == 3
            solved[level, part] = sum(map(results_table.solves, own))
            left = [r for r in own if not results_table.solves(r)]
            others |= {(level, part, r["seed"]): (r["ends_in"], float(r["J_C"])) for r in left}
    total = {part: sum(solved[level, part] for level in range(4)) for part in results_table.PARTS}
    assert (total["horizon"], total["novelty"], total["streak"]) == (7, 8, 11)
    assert [total[part] for part in ("scale", "share", "brown", "speed")] == [10] * 4

    def places(part):
        """Level and kind of place of the runs that do not solve it."""
        return [(key[0], of[0].partition(" (")[0].split()[-1]) for key, of in found(part)]

    def found(part):
        return [(key, of) for key, of in others.items() if key[1] == part]

    assert places("horizon") == [(0, "rim")] * 2 + [(1, "rim")] * 2 + [(3, "cut-out")]
    assert places("novelty") == [(0, "rim")] * 3 + [(2, "through")]
    assert round(found("novelty")[-1][1][1], 1) == 5.2
    assert places("scale") == [(2, "cut-out")] * 2
    assert places("speed") == [(0, "rim")] * 2
    assert places("brown") == [(2, "cut-out"), (3, "cut-out")]
    assert places("share") == [(0, "rim"), (2, "cut-out")]
    assert round(found("share")[0][1][1]) == 22


def test_the_safety_tasks_of_sac_lb_streak():
    """Ranges overlap SAC-LB's or are on the better side of them."""
    rows = results_table.safety(results_table.SAFETY)
    assert len(rows) == 6
    assert all(row in SOLVE for row in rows)
    found = runs(results_table.SAFETY)
    assert len(found) == 18
    for task in {row["task"] for row in found}:
        of = {
            (name, m): [
                float(row[m])
                for row in found
                if row["task"] == task and row["folder"].endswith(f"-{name}")
            ]
            for name in ("sac-lb", "sac-lb-streak")
            for m in ("J_R", "J_C", "EMCC_0.33", "EMCC_0.66")
        }
        assert max(of["sac-lb-streak", "J_R"]) > min(of["sac-lb", "J_R"])
        assert min(of["sac-lb-streak", "J_C"]) < max(of["sac-lb", "J_C"])
        if "PointGoal1" in task:
            assert max(of["sac-lb", "J_R"] + of["sac-lb-streak", "J_R"]) < 0
        if "PointCircle1" in task:
            for m, gap in (("EMCC_0.33", 0.30), ("EMCC_0.66", 0.23)):
                higher = np.mean(of["sac-lb-streak", m]) - np.mean(of["sac-lb", m])
                assert round(float(higher), 2) == gap
