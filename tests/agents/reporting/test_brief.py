"""What a terminal shows of a table: the means, in lines that fit."""

import re
from dataclasses import replace

from agents.reporting.table import Number, Row, Table, show

MEAN = [Number(0.5, low=0.25, high=0.75), Number(3.0, low=1.0, high=9.0, is_range=True)]
TABLE = Table(
    "a long legend",
    ["task", "EMCC", "streak", "within limit", "ends in"],
    [
        Row(
            "CPO, mean of 5",
            [*MEAN, Number(2, low=0.1, high=0.9, total=5)],
            "rim 5 of 5 [.4, 1]",
            "mean",
        ),
        Row("CPO, paper", [Number(0.4), Number(None), Number(None)], kind="paper"),
        Row("CPO, seed 0", [Number(0.6), Number(2.0), Number(1, total=1)], "rim"),
    ],
    details=["streak"],
)


def test_a_terminal_has_the_means(capsys):
    show([TABLE], 80, "runs/index.html")
    printed = capsys.readouterr().out
    assert "a long legend" not in printed and "streak" not in printed and "seed 0" not in printed
    assert re.search(r"^task, n = 5 +EMCC +within limit +ends in$", printed, re.MULTILINE)
    assert re.search(r"^CPO +0\.50 +2 of 5 +rim 5 of 5$", printed, re.MULTILINE)
    assert re.search(r"^CPO, paper +0\.40 +– *$", printed, re.MULTILINE)
    assert "runs/index.html" in printed
    assert max(map(len, printed.splitlines())) <= 80


def test_other_numbers_of_runs_stand_in_the_rows(capsys):
    more = replace(TABLE.rows[0], name="WCSAC (batch 5), mean of 3")
    show([replace(TABLE, rows=[*TABLE.rows, more])], 80, "runs/index.html")
    printed = capsys.readouterr().out
    assert re.search(r"^task +EMCC", printed, re.MULTILINE)
    assert re.search(r"^CPO, n = 5 +0\.50", printed, re.MULTILINE)
    assert re.search(r"^WCSAC \(batch 5\), n = 3 +0\.50", printed, re.MULTILINE)
