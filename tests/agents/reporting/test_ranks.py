"""Ranks over tasks by hand, and a method of one's own among published ones, by one command."""

import numpy as np
import pytest

import agents
from agents import algorithms
from agents.cli.main import main
from agents.reporting.overall import order_row, ranks_and_wins

MINE = '''
"""CPO by another name."""

from dataclasses import dataclass

import agents
from agents.algorithms import cpo


@dataclass(frozen=True)
class Config(cpo.CPOConfig):
    """Hyper-parameters of Mine."""


agents.register("mine", cpo.ALGORITHM._replace(title="Mine", config=Config))
'''


def test_ranks_and_probability_of_improvement():
    """Task 1: means 1, 2, 3; task 2: 2 (runs 1 and 3), 2, 1. Mean ranks (1 + 2.5)/2, (2 + 2.5)/2,
    (3 + 1)/2. The first is better on task 1 with 1; on task 2 than the second with ½, than the
    third, which ties with one run, with ¼: (1 + .375)/2."""
    first = [np.array(v) for v in ([1.0, 1.0], [2.0], [3.0, 3.0, 3.0])]
    second = [np.array(v) for v in ([1.0, 3.0], [2.0, 2.0], [1.0, 1.0])]
    ranks, wins = ranks_and_wins([first, second])
    assert ranks[0].tolist() == [1.75, 2.25, 2.0]
    assert wins[0, 0] == pytest.approx(0.6875)
    # Drawn again, the runs (1, 3) are (1, 1) with ¼: tied with the third for the best.
    assert np.mean(ranks[1:, 0] == (1 + 1.5) / 2) == pytest.approx(0.25, abs=0.05)
    assert wins[1:].sum(axis=1) == pytest.approx(1.5)  # of each pair one is the better


def test_what_is_ordered_otherwise():
    """Of three pairs one, A and B: .1 before .2, but .5 after .2; tau = (2 - 1)/3."""
    rates = {"A": [0.1, 0.1], "B": [0.3, 0.1], "C": [0.3, 0.3]}
    emccs = {"A": [0.5, 0.5], "B": [0.1, 0.3], "C": [0.6, 0.6]}
    row = order_row("task", rates, emccs)
    counted, tau, rate, emcc = (cell.value for cell in row.numbers)
    assert (counted, row.numbers[0].total, row.ends) == (1, 3, "A, B")
    assert (tau, rate, emcc) == pytest.approx((1 / 3, -0.1, 0.3))


@pytest.mark.slow
def test_a_method_of_ones_own_beside_published_ones(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(algorithms._algorithms, "registered", {})
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_method.py").write_text(MINE)
    command = ["reproduce", "--benchmark", "--tasks", "Circle2D-0-v0", "Circle2D-1-v0"]
    command += ["--quick", "--seeds", "0", "1", "2", "--steps", "1600", "--workers", "1"]
    assert main([*command, "--algorithms", "cpo", "trpo-lag", "--out", "published"]) == 0
    report = (tmp_path / "published" / "report.md").read_text()
    assert "Ranks over tasks" not in report  # of two algorithms
    agents.report(tmp_path / "published", archive=tmp_path / "published.zip")
    command += ["--import", "my_method", "--algorithms", "mine", "--out", "mine"]
    assert main([*command, "--beside", "nowhere.zip"]) == 2
    assert main([*command, "--beside", "published.zip"]) == 0
    report = (tmp_path / "mine" / "report.md").read_text()
    ranks = report.split("## Ranks over tasks")[1].split("## ")[0]
    rows = {
        line.split("|")[1].strip(): line.split("|")[2]
        for line in ranks.splitlines()[2:]
        if "seeds" in line[:40]
    }
    assert set(rows) >= {f"{name}, 3 to 3 seeds" for name in ("CPO", "TRPO-Lag", "Mine")}
    # Equal algorithms with equal seeds have equal ranks.
    assert rows["CPO, 3 to 3 seeds"].split("[")[0] == rows["Mine, 3 to 3 seeds"].split("[")[0]
    assert "What EMCC orders otherwise" in report
    capsys.readouterr()
    assert main([*command[:4], "--benchmark", "--safety", "--out", "x"]) == 2
