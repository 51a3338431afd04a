"""Two sets of runs side by side, from files written by hand."""

import csv
import json
import re

from agents.cli.main import main
from agents.paper.presets import preset
from agents.reporting.compare import compare
from agents.training.config import TrainConfig


def write_runs(folder, name, j_r, task="Circle2D-1-v0", steps=100, streak=4):
    """A run for each of some returns, of ten episodes of ten steps with four at a cost."""
    seeds = tuple(range(len(j_r)))
    TrainConfig(name, task, seeds, steps, preset(name, task)).write(folder)
    for seed, value in zip(seeds, j_r, strict=True):
        lines = ["rollout,start_step,length,return,cost,longest_streak"]
        lines += [f"{k},{10 * k},10,-1.0,4.0,{streak}" for k in range(steps // 10)]
        (folder / f"seed-{seed}" / "episodes.csv").write_text("\n".join([*lines, ""]))
        at = [[1.0, 0.0]]
        of = {"J_R": value, "J_C": 4.25, "CVaR_0.5": 6.5, "final_observations": at}
        content = {"episodes": 1, "deterministic": of, "stochastic": of}
        (folder / f"seed-{seed}" / "evaluation.json").write_text(json.dumps(content))
    return folder


def rows(markdown):
    """Cells by the row's name, which here says of most runs that they took 100 steps."""
    markdown = markdown.replace(" (100 steps)", "")
    cells = [[c.strip() for c in line.split("|")[1:-1]] for line in markdown.splitlines()]
    return {row[0]: row[1:] for row in cells if row}


def test_by_hand(tmp_path):
    a = write_runs(tmp_path / "a", "trpo-lag", [-10.0, -20.0])
    b = write_runs(tmp_path / "b", "cpo", [-5.0, -9.0], streak=3)
    markdown = compare(a, b)
    found = rows(markdown)
    assert found["A: TRPO-Lag, mean of 2"][4] == "-15.00 [-20.00, -10.00]"
    assert found["B: CPO, mean of 2"][4] == "-7.00 [-9.00, -5.00]"
    # Of the 16 resamples of two seeds each, the lowest difference, -9 + 10, has a share of 1/16,
    # which is above 2.5 %; so has the highest, -5 + 20.
    assert found["B - A: CPO - TRPO-Lag"][4] == "+8.00 [+1.00, +15.00]"
    assert found["B - A: CPO - TRPO-Lag"][0] == "-0.10 [-0.10, -0.10]"
    assert found["B - A: CPO - TRPO-Lag"][5] == "+0.00 [+0.00, +0.00]"
    assert found["A: TRPO-Lag, seed 1"] == [
        *("0.40", "0.40", "0.40", "0.40", "-20.00", "4.25", "6.50", "–", "right rim")
    ]
    assert "resamples the seeds of either side independently" in markdown
    assert rows(compare(b, a))["B - A: TRPO-Lag - CPO"][4] == "-8.00 [-15.00, -1.00]"


def test_which_stands_against_which(tmp_path):
    for name in ("trpo-lag", "cpo"):
        write_runs(tmp_path / "a" / name, name, [-10.0, -12.0])
        write_runs(tmp_path / "b" / name, name, [-11.0, -12.0])
    write_runs(tmp_path / "b" / "wcsac", "wcsac", [-11.0, -12.0])
    found = rows(compare(tmp_path / "a", tmp_path / "b"))
    assert [name for name in found if name.startswith("B - A")] == [
        *("B - A: CPO", "B - A: TRPO-Lag", "B - A: WCSAC - CPO", "B - A: WCSAC - TRPO-Lag")
    ]


def test_one_seed_other_tasks_and_other_steps_are_named(tmp_path):
    write_runs(tmp_path / "a" / "1", "cpo", [-10.0])
    write_runs(tmp_path / "a" / "2", "cpo", [-10.0, -11.0], task="Circle2D-2-v0")
    b = write_runs(tmp_path / "b", "cpo", [-5.0, -9.0], steps=200)
    markdown = compare(tmp_path / "a", b)
    assert rows(markdown)["B - A: CPO (200 steps) - CPO"][4] == "+3.00"
    assert (
        "Circle2D-1-v0, A: CPO (100 steps) has one seed: no interval, of its mean or difference."
        in markdown
    )
    assert "only A has runs on Circle2D-2-v0." in markdown
    assert "Circle2D-2-v0 |" not in markdown


def test_what_is_written(tmp_path, capsys):
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
    lines = list(csv.DictReader((out / "compare.csv").read_text().splitlines()))
    found = [(x["algorithm"], x["kind"], x["seed"], float(x["J_R"])) for x in lines]
    assert found == [
        ("A: CPO (100 steps)", "mean", "", -15),
        ("A: CPO (100 steps)", "mean low", "", -20),
        ("A: CPO (100 steps)", "mean high", "", -10),
        ("A: CPO (100 steps)", "run", "0", -10),
        ("A: CPO (100 steps)", "run", "1", -20),
        ("B: CPO (100 steps)", "mean", "", -7),
        ("B: CPO (100 steps)", "mean low", "", -9),
        ("B: CPO (100 steps)", "mean high", "", -5),
        ("B: CPO (100 steps)", "run", "0", -5),
        ("B: CPO (100 steps)", "run", "1", -9),
        ("B - A: CPO (100 steps)", "difference", "", 8),
        ("B - A: CPO (100 steps)", "difference low", "", 1),
        ("B - A: CPO (100 steps)", "difference high", "", 15),
    ]
    html = (out / "compare.html").read_text()
    assert "+8.00<br><small>[+1.00, +15.00]</small>" in html
    assert "A: CPO" in html
    first = {path.name: path.read_bytes() for path in out.iterdir()}
    assert main(["compare", str(a), str(b), "--out", str(out)]) == 0
    assert {path.name: path.read_bytes() for path in out.iterdir()} == first


def test_mistakes(tmp_path, capsys):
    a = write_runs(tmp_path / "a", "cpo", [-10.0])
    b = write_runs(tmp_path / "b", "cpo", [-5.0], task="Circle2D-2-v0")
    for arguments, message in (
        ([a, b], "have no task in common: Circle2D-1-v0 against Circle2D-2-v0"),
        ([a, tmp_path / "none"], "none is no folder"),
        ([a], "required"),
        ([a, a, "--out", a / "config.json"], "config.json"),
    ):
        assert main(["compare", *map(str, arguments)]) == 2
        out, err = capsys.readouterr()
        assert out == ""
        assert err.startswith("circle2d: ")
        assert err.count("\n") == 1
        assert re.search(message, err), err
