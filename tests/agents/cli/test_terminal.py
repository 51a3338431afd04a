"""Tables on a terminal: within its width, with every cell, at any width."""

import re

import pytest

from agents.reporting import table as terminal
from agents.reporting.table import Number, Row, Table

NAMES = ["TRPO-Lag (250,000 steps), mean of 3", "TRPO-Lag, paper (3 seeds)", "CPO | \x1b[1m2"]
HEAD = ["Circle2D-1-v0", *(f"EMCC_{part}" for part in (0.33, 0.66, 0.99)), "cost rate", "ends in"]
CELLS = [
    Number(0.81, low=0.80, high=0.82, marked=True),
    Number(0.21),
    Number(-4.0, low=-4.03, high=-3.96),
    Number(1, 0),
]
TABLE = Table(
    "EMCC with alpha = 0.1, in words that are longer than a narrow terminal is wide by far.",
    HEAD,
    [Row(name, CELLS) for name in NAMES],
    ["a note."],
)
CLAIMS = "## Claims\n\n- one: **confirmed**\n- two\n"


@pytest.mark.parametrize("width", [80, 100, 200])
def test_tables_fit_and_lose_nothing(width, capsys):
    terminal.show([TABLE, CLAIMS], width)
    out = capsys.readouterr().out
    assert max(len(line.rstrip()) for line in out.splitlines()) <= width
    assert "…" not in out
    words = set(re.findall(r"\S+", out))
    shown = [*NAMES[:2], "CPO | \\x1b[1m2", *HEAD[:-1]]  # no run ends anywhere
    assert set(" ".join(shown).split()) <= words
    assert "ends" not in words
    assert {"0.81", "[0.80,", "0.82]", "[-4.03,", "-3.96]", "1"} <= words
    assert "a note." in out
    assert {"Claims", "confirmed"} <= words
    assert ("**" in out, "---" in out, "\\|" in out) == (False, False, False)


def lines(parts):
    """The cells of each part, row by row."""
    return [[[words for words, _ in row] for row in zip(*part, strict=True)] for part in parts]


def test_parts_by_hand():
    numbers = [Number(1, 0, low=0, high=2, marked=True), Number(22, 0)]
    table = Table("", ["name", "first", "second"], [Row("a", numbers)])
    # name 4, then gap 3 and 6, then gap 3 and 6: 22 in all.
    [whole] = terminal.parts(table, 22)
    assert [column[1][1] for column in whole] == [False, True, False]
    assert lines(terminal.parts(table, 21)) == [
        [["name", "first"], ["a", "1\n[0, 2]"]],
        [["name", "second"], ["a", "22"]],
    ]


def test_into_a_pipe_it_is_markdown(capsys):
    terminal.show([TABLE, CLAIMS])
    out = capsys.readouterr().out
    rows = [line.split("|")[1:-1] for line in out.splitlines() if line.startswith("|")]
    expected = [NAMES[0], "**0.81** [0.80, 0.82]", "0.21", "-4.00 [-4.03, -3.96]", "1"]
    assert [cell.strip() for cell in rows[2]] == expected
    assert len(rows) == 2 + len(NAMES)
    assert out.endswith(f"\n\nNote: a note.\n\n{CLAIMS}\n")


def test_lines_of_a_cell_by_hand():
    within = [Number(1, low=0.01, high=0.91, total=3), Number(0, total=1)]
    rows = [Row("SAC-LB-Streak, seed 0", within[:1], "corridor, round (80 %, 20 % through)")]
    rows += [Row("b", within[1:])]
    assert lines(terminal.parts(Table("", ["name", "within", "ends in"], rows), 80)) == [
        [
            ["name", "within", "ends in"],
            [
                "SAC-LB-Streak, seed 0",
                "1 of 3\n[0.01, 0.91]",
                "corridor, round\n(80 %, 20 % through)",
            ],
            ["b", "0 of 1", ""],
        ]
    ]
    [part] = lines(terminal.parts(Table("", ["name", "within"], rows), 40))
    assert part[1][0] == "SAC-LB-Streak,\nseed 0"


def test_latex_by_hand():
    rows = [Row("a_1 & b", [Number(0.5, low=0.25, high=1, marked=True), Number(None)])]
    words = Table("", ["100 %", "x", "y", "ends in"], rows).latex()
    assert words.splitlines()[2:5] == [
        r"100 \% & x & y \\",
        r"\midrule",
        r"a\_1 \& b & \textbf{0.50} [0.25, 1.00] & -- \\",
    ]
    assert words.startswith("\\begin{tabular}{lrr}")
