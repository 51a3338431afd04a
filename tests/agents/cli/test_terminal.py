"""Tables on a terminal: within its width, with every cell, at any width."""

import re

import pytest

from agents.cli import terminal

NAMES = ["TRPO-Lag (250,000 steps), mean of 3", "TRPO-Lag, paper (3 seeds)", "CPO"]
HEAD = ["Circle2D-1-v0", *(f"EMCC_{part}" for part in (0.33, 0.66, 0.99)), "cost rate", "ends in"]
CELLS = "**0.81** [0.80, 0.82] | 0.21 | -4.00 [-4.03, -3.96] | 1 | "
MARKDOWN = "\n".join(
    [
        "EMCC with alpha = 0.1, in words that are longer than a narrow terminal is wide by far.",
        "",
        f"| {' | '.join(HEAD)} |",
        f"| {' | '.join(['---'] * len(HEAD))} |",
        *(f"| {name} | {CELLS} |" for name in NAMES),
        "",
        "Note: a note.",
        "",
    ]
)


@pytest.mark.parametrize("width", [80, 100, 200])
def test_tables_fit_and_lose_nothing(width, capsys):
    terminal.show(MARKDOWN, width)
    out = capsys.readouterr().out
    assert max(len(line.rstrip()) for line in out.splitlines()) <= width
    assert "…" not in out
    words = set(re.findall(r"\S+", out))
    assert set(" ".join([*NAMES, *HEAD]).split()) <= words
    assert {"0.81", "[0.80,", "0.82]", "[-4.03,", "-3.96]", "1"} <= words
    assert "a note." in out
    assert ("**" in out, "---" in out) == (False, False)


def test_parts_by_hand():
    rows = [["name", "first", "second"], ["a", "1 [0, 2]", "22"]]
    # name 4, then gap 3 and 6, then gap 3 and 6: 22 in all.
    assert len(terminal.parts(rows, 22)) == 1
    assert terminal.parts(rows, 21) == [
        [["name", "first"], ["a", "1\n[0, 2]"]],
        [["name", "second"], ["a", "22"]],
    ]


def test_into_a_pipe_it_stays_markdown(capsys):
    terminal.show(MARKDOWN)
    assert capsys.readouterr().out == MARKDOWN + "\n"


def test_lines_of_a_cell_by_hand():
    rows = [["name", "within"], ["SAC-LB-Streak, seed 0", "1 of 3 [0.01, 0.91]"], ["b", "0 of 1"]]
    assert terminal.parts(rows, 40) == [
        [
            ["name", "within"],
            ["SAC-LB-Streak,\nseed 0", "1 of 3\n[0.01, 0.91]"],
            ["b", "0 of 1"],
        ]
    ]
