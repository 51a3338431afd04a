"""Learning curves for papers: what is drawn, with which names and colours, and equal files."""

import re

import numpy as np
import pytest
from small_runs import write_evaluated

import agents
from agents.cli.main import main
from agents.errors import UserError
from agents.reporting import figures
from agents.reporting import plot as plotting


@pytest.fixture
def runs(tmp_path):
    for name, costs in (("cpo", (1, 2, 3)), ("trpo-lag", (4, 6))):
        write_evaluated(tmp_path / "runs" / name, name, costs=costs)
    return tmp_path / "runs"


def lines_drawn(monkeypatch, *args, **options):
    """Return the name, colour and values of each line that a plot draws."""
    drawn = []

    def draw(axis, name, style, at, curve):
        axis.plot(at, curve.mean, label=name, color=style.colour)
        drawn.append((name, style.colour, at, curve.mean))

    monkeypatch.setattr(figures, "draw_curve", draw)
    agents.plot(*args, **options)
    return drawn


def test_curves_are_means_over_seeds_with_the_given_names_and_colours(runs, tmp_path, monkeypatch):
    """Every episode of a run has the cost in the fixture."""
    how = {"names": {"CPO": "ours"}, "colours": {"TRPO-Lag": "C3"}}
    out = tmp_path / "new" / "figure.svg"
    found = lines_drawn(monkeypatch, runs, out=out, measures=["cost", "return"], **how)
    assert [name for name, *_ in found] == ["TRPO-Lag", "ours"] * 2
    assert found[0][1] == "C3" != found[1][1]
    means = {name: np.unique(mean[np.isfinite(mean)]) for name, _, _, mean in found[:2]}
    assert {name: mean.tolist() for name, mean in means.items()} == {
        "TRPO-Lag": [5.0],
        "ours": [2.0],
    }
    assert all(at[0] == 1.0 and at[-1] == 99.0 for *_, at, _ in found)  # middles of fifty parts
    words = re.findall(r"<text[^>]*>([^<]*)</text>", out.read_text())
    assert {"ours", "TRPO-Lag", "cost limit", "Circle2D-1-v0", "return"} <= set(words)


@pytest.mark.parametrize("suffix", [".pdf", ".svg", ".png"])
def test_equal_runs_give_equal_files(runs, tmp_path, suffix):
    first, second = (tmp_path / f"{name}{suffix}" for name in "ab")
    for file in (first, second):
        agents.plot(runs, out=file)
    assert first.read_bytes() == second.read_bytes()
    assert b"/Type3" not in first.read_bytes()  # fonts that journals refuse


def test_the_name_of_an_algorithm_stands_for_its_only_curve():
    entries = ["CPO (100 steps)", "PPO-Lag", "PPO-Lag (clip_range 0.1)", "SAC (a 1)", "SAC (a 2)"]
    found = plotting._given("names", {"CPO": "ours", "PPO-Lag": "theirs"}, entries)
    assert found == {"CPO (100 steps)": "ours", "PPO-Lag": "theirs"}
    for name in ("SAC", "CP"):
        with pytest.raises(UserError, match=f"no curve is called '{name}'"):
            plotting._given("names", {name: "x"}, entries)


def test_mistakes_are_named_and_nothing_is_written(runs, tmp_path, capsys):
    for args, words in (
        (["--out", "a.jpg"], "out must end in .pdf, .svg, .png, .pgf, got 'a.jpg'"),
        (["--names", "CP", "x"], "names: no curve is called 'CP'"),
        (["--colours", "CPO", "rde"], "'rde' is no colour of matplotlib"),
        (["--measure", "reward"], "measure 'reward' cannot be drawn"),
        (
            ["--measure", "J_R"],
            "valid are return, cost, emcc, length; it is a number of a whole run",
        ),
    ):
        assert main(["plot", str(runs), "--out", str(tmp_path / "a.pdf"), *args]) == 2
        assert words in capsys.readouterr().err
    assert main(["plot", str(tmp_path), "--out", str(runs)]) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["runs"]


def test_the_command_prints_the_caption(runs, tmp_path, capsys):
    out = tmp_path / "figure.pdf"
    assert main(["plot", str(runs), "--out", str(out), "--measure", "emcc"]) == 0
    path, caption = capsys.readouterr().out.splitlines()
    assert path == str(out)
    assert "mean over 2 to 3 seeds; areas: their range." in caption
    assert "α = 0.1" in caption
