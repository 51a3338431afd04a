"""Tables on a terminal: what they show, their width, and characters that it lacks."""

import io
import re
import sys
from dataclasses import replace

import pytest

from agents.cli.main import main
from agents.reporting.table import Number, Row, Table, show

NAMES = ["TRPO-Lag (250,000 steps), mean of 3", "TRPO-Lag, paper (3 seeds)", "CPO | \x1b[1m2"]
HEAD = ["Circle2D-1-v0", *(f"EMCC_{part}" for part in (0.33, 0.66, 0.99)), "cost rate", "ends in"]
CELLS = [
    Number(0.81, low=0.80, high=0.82, marked=True),
    Number(0.21),
    Number(-4.0, low=-4.03, high=-3.96),
    Number(1, 0),
]
LEGEND = "EMCC with alpha = 0.1, in words that are longer than a narrow terminal is wide by far."
TABLE = Table(LEGEND, HEAD, [Row(name, CELLS) for name in NAMES], ["a note."])
CLAIMS = "## Claims\n\n- one: **confirmed**\n- two\n"


@pytest.mark.parametrize("width", [80, 200])
def test_tables_fit_and_lose_nothing(width, capsys):
    show([TABLE, CLAIMS], width)
    out = capsys.readouterr().out
    assert max(len(line.rstrip()) for line in out.splitlines()) <= width
    words = set(re.findall(r"\S+", out))
    assert set(" ".join([*NAMES[:2], "CPO | \\x1b[1m2", *HEAD[:-1]]).split()) <= words
    assert {"0.81", "[0.80,", "0.82]", "[-4.03,", "-3.96]", "1", "note.", "confirmed"} <= words
    assert ("**" in out, "---" in out, "\\|" in out) == (False, False, False)


BRIEF_MEAN = [Number(0.5, low=0.25, high=0.75), Number(3.0, low=1.0, high=9.0, is_range=True)]
BRIEF_MEAN += [Number(2, low=0.1, high=0.9, total=5)]
ROWS = [
    Row("CPO, mean of 5", BRIEF_MEAN, "rim 5 of 5 [.4, 1]", "mean"),
    Row("CPO, paper", [Number(0.4), Number(None), Number(None)], kind="paper"),
    Row("CPO, seed 0", [Number(0.6), Number(2.0), Number(1, total=1)], "rim"),
]
BRIEF_HEAD = ["task", "EMCC", "streak", "within limit", "ends in"]
BRIEF = Table("a long legend", BRIEF_HEAD, ROWS, details=["streak"])


def test_a_terminal_shows_the_means_without_details(capsys):
    show([BRIEF], 80, "runs/index.html")
    printed = capsys.readouterr().out
    assert "a long legend" not in printed and "streak" not in printed and "seed 0" not in printed
    assert re.search(r"^task, n = 5 +EMCC +within limit +ends in$", printed, re.MULTILINE)
    assert re.search(r"^CPO +0\.50 +2 of 5 +rim 5 of 5$", printed, re.MULTILINE)
    assert re.search(r"^CPO, paper +0\.40 +– *$", printed, re.MULTILINE)
    assert "runs/index.html" in printed
    assert max(map(len, printed.splitlines())) <= 80


def test_numbers_of_runs_that_differ_stand_in_the_rows(capsys):
    more = replace(ROWS[0], name="WCSAC (batch 5), mean of 3")
    show([replace(BRIEF, rows=[*ROWS, more])], 80, "runs/index.html")
    printed = capsys.readouterr().out
    assert re.search(r"^task +EMCC", printed, re.MULTILINE)
    assert re.search(r"^CPO, n = 5 +0\.50", printed, re.MULTILINE)
    assert re.search(r"^WCSAC \(batch 5\), n = 3 +0\.50", printed, re.MULTILINE)


def test_characters_that_the_encoding_lacks_are_replaced(monkeypatch):
    printed = {}
    for encoding in ("utf-8", "iso-8859-9", "ascii"):  # iso-8859-9 is the locale tr_TR's
        monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(io.BytesIO(), encoding=encoding))
        assert main(["zoo"]) == 0
        printed[encoding] = sys.stdout.buffer.getvalue()
    text = printed["utf-8"].decode()
    assert "–" in text
    assert printed == {encoding: text.encode(encoding, "replace") for encoding in printed}


@pytest.mark.parametrize("command", ["zoo", "--help"])
def test_an_output_that_is_closed_is_no_error(command, monkeypatch):
    monkeypatch.setattr(sys, "stdout", None)
    assert main([command]) == 0
