"""Trainings take whole epochs: labels, axes and thirds of training refer to the steps taken, not to
those asked for."""

import json

from small_runs import TASK, TRPO, chain, evaluate, lines_of, write_evaluated, write_runs

import agents
import emcc.__main__
from agents.cli.main import main
from agents.reporting.compare import compare
from agents.reporting.figures import emcc_along, episode_means, midpoints
from agents.reporting.report import report
from agents.reporting.table import markdown
from agents.results.reading import read_groups
from agents.results.statistics import by_third

STREAKS = [0, 0, 0, 10, 0, 5, 0, 0, 2, 0]
"""The longest streaks of ten episodes of ten steps. In the 100 steps taken, those above 0 are in
the first, second and last third; in 75 steps the first two would be in later thirds."""
THIRDS = [1.0, 0.5, 0.2]


def write(folder, asked, name="ppo-lag", task="Circle2D-1-v0"):
    """Write two runs that took 100 steps where `asked` were asked for."""
    costs = [cost for streak in STREAKS for cost in chain(streak, 10)]
    write_evaluated(folder, name, [costs, costs], task=task)
    config = json.loads((folder / "config.json").read_text())
    (folder / "config.json").write_text(json.dumps(config | {"steps": asked}))
    return folder


def test_thirds_are_of_the_steps_taken(tmp_path, capsys):
    (group,) = read_groups([write(tmp_path / "a", 75)], [])
    for run in group.runs:
        assert [run.measures[f"EMCC_{part}"] for part in (0.33, 0.66, 0.99)] == THIRDS
    # Cost steps per step of each third, whose episodes start at 0 to 30, 40 to 60 and 70 to 90.
    assert by_third(group, "rate") == {0.33: [10 / 40] * 2, 0.66: [5 / 30] * 2, 0.99: [2 / 30] * 2}
    assert emcc.__main__.main([str(tmp_path / "a")]) == 0
    row = capsys.readouterr().out.splitlines()[-1].split()
    assert [row[k] for k in (5, 6, 11, 16)] == ["100", "1.000", "0.500", "0.200"]


def test_curves_end_with_the_steps_taken(tmp_path):
    (group,) = read_groups([write(tmp_path / "a", 75)], [])
    costs = episode_means(group, "cost").mean
    at = midpoints(group.total_steps)
    assert {int(x): c for x, c in zip(at, costs, strict=True) if c == c} == {
        10 * k + 1: streak for k, streak in enumerate(STREAKS)
    }
    assert len(emcc_along(group.runs[0].records, group.total_steps)) == len(at)


def test_every_label_has_the_steps_taken(tmp_path):
    a, b = write(tmp_path / "all" / "a", 75), write(tmp_path / "all" / "b", 100, "sac-lag")
    report(tmp_path / "all")
    for name in ("report.md", "report.csv", "report.tex", "index.html"):
        words = (tmp_path / "all" / name).read_text()
        assert "100 steps" in words
        assert "75 steps" not in words
        # A length that all runs have is in no name, but in files of numbers.
        assert ("(100 steps)" in words) == name.endswith(".csv")
    assert "unequal length" not in (tmp_path / "all" / "report.md").read_text()
    names = {line["algorithm"] for line in lines_of(tmp_path / "all" / "report.csv")}
    assert {"PPO-Lag (100 steps)", "SAC-Lag (100 steps)"} <= names
    assert "unequal length" not in markdown(compare(a, b))


def test_trainings_of_unequal_length_are_named(tmp_path):
    a, b = tmp_path / "all" / "a", tmp_path / "all" / "b"
    write(a, 75, task=TASK)
    write_runs(b)  # of 120 steps
    evaluate(b)
    report(tmp_path / "all")
    for words in ((tmp_path / "all" / "report.md").read_text(), markdown(compare(a, b))):
        assert "unequal length, from 100 steps (PPO-Lag (100 steps)) to 120 (SAC-Lag" in words


def test_train_says_that_it_rounds_up(tmp_path, capsys):
    """An epoch has two episodes of 50 steps."""
    given = [word for k, v in TRPO.items() for word in (f"--{k.replace('_', '-')}", v)]
    given = [str(w) for word in given for w in (word if isinstance(word, tuple) else (word,))]
    for steps, told in ((60, True), (100, False)):
        out = tmp_path / str(steps)
        command = ["train", "trpo-lag", "--task", "Circle2D-1-v0", "--seeds", "0", *given]
        assert main([*command, "--steps", str(steps), "--out", str(out)]) == 0
        shown = capsys.readouterr()
        lines = [line for line in shown.err.splitlines() if "rounded up" in line]
        assert len(lines) == told
        assert all("60 steps are rounded up to 100" in line for line in lines)
        assert "100 steps" in shown.out
        assert "60 steps" not in shown.out
        (found,) = agents.Runs([out]).records.values()
        assert found.total_steps == 100
