"""Logs of other libraries, and the panel on the command line."""

import csv

import numpy as np
import pytest

from emcc.__main__ import main

MONITOR = """#{"t_start": 1.5, "env_id": "Circle2D-1-v0"}
r,l,t,cost
1.5,10,0.1,0.0
2.5,10,0.2,6.0
3.5,10,0.3,10.0
"""
OMNISAFE = """Metrics/EpRet,Metrics/EpCost,Metrics/EpLen,Train/Epoch,Loss/Loss_pi,TotalEnvSteps
1.0,50.0,100.0,0.0,60.0,2000.0
2.0,10.0,50.0,1.0,20.0,3000.0
"""
SAFEPO = """Metrics/EpRet,Metrics/EpCost,Metrics/EpLen,Train/Epoch,Train/TotalSteps
1.0,50.0,100.0,1,2000
2.0,10.0,50.0,2,3000
"""


def table(capsys, *arguments, status=1):
    assert main([*map(str, arguments), "--format", "csv"]) == status
    output, errors = capsys.readouterr()
    lines = output.splitlines()
    return list(csv.DictReader(line for line in lines if not line.startswith("#"))), lines, errors


def test_a_monitor_file_gives_bounds(tmp_path, capsys):
    path = tmp_path / "0.monitor.csv"
    path.write_text(MONITOR)
    (row,), lines, errors = table(capsys, tmp_path, "--limit", 5)  # found in its folder
    assert row["at least"] == f"{(0 + 2 + 10) / 30:.3f}"
    assert row["at most"] == f"{16 / 30:.3f}"
    assert row["cost rate"] == f"{16 / 30:.3f}"
    assert (row["violation rate V"], row["cost regret"]) == ("0.667", "6.000")
    assert (row["severity D"], row["severity of violations D+"]) == ("0.067", "0.600")
    assert lines[0].startswith("# Bounds, not EMCC")
    assert errors == f"python -m emcc: {path}: sums of episodes cannot give EMCC\n"


@pytest.mark.parametrize("text", [OMNISAFE, SAFEPO], ids=["OmniSafe", "SafePO"])
def test_means_of_epochs_give_a_cost_rate(tmp_path, capsys, text):
    path = tmp_path / "seed-0" / "progress.csv"
    path.parent.mkdir()
    path.write_text(text)
    (row,), lines, errors = table(capsys, tmp_path, "--limit", 25)
    assert row == {
        "file": str(path), "epochs": "2", "steps": "3000",
        "cost rate": f"{(2000 * 0.5 + 1000 * 0.2) / 3000:.3f}",
        "highest mean cost": "50.000", "last mean cost": "10.000",
        "epochs with a mean above 25": "0.500",
    }  # fmt: skip
    assert "neither EMCC and its bounds nor violation rate" in lines[0]
    assert errors == f"python -m emcc: {path}: means of epochs cannot give EMCC\n"


def changed(text, old, new):
    assert old in text
    return text.replace(old, new)


BAD = {
    "no cost": ("#{}\nr,l,t\n1,2,3\n", "without costs (columns r, l, t): train with emcc.sb3"),
    "last step": ("#{}\nr,l,t,cost\n1,2,3,1.0\n1,2,3,0.0\n", "those of each episode's last step"),
    "no episode": ("#{}\nr,l,t,cost\n", "no episodes"),
    "cell": (changed(MONITOR, "6.0", "six"), "line 4, column cost: 'six' is not a number"),
    "only a comment": ("#{}\n", "the file is empty; a header line is needed"),
    "no length": (changed(SAFEPO, "EpLen", "EpRat"), "without Metrics/EpLen"),
    "no steps": (changed(SAFEPO, "TotalSteps", "Steps"),
        "without TotalEnvSteps or Train/TotalSteps"),
    "negative": (changed(SAFEPO, "50.0,100", "-50.0,100"), "EpCost must be finite and >= 0"),
    "NaN": (changed(OMNISAFE, "10.0,50", "nan,50"), "must be finite and >= 0, got nan at index 1"),
    "order": (changed(SAFEPO, "3000", "2000"), "the steps must rise from row to row"),
    "no epochs": (SAFEPO.splitlines()[0] + "\n", "no epochs"),
}  # fmt: skip


@pytest.mark.parametrize(("text", "message"), BAD.values(), ids=BAD)
def test_mistakes_are_one_line(tmp_path, capsys, text, message):
    path = tmp_path / "log.csv"
    path.write_text(text)
    with pytest.raises(SystemExit) as stop:
        main([str(path)])
    output, errors = capsys.readouterr()
    assert (stop.value.code, output, errors.count("\n")) == (2, "", 1)
    assert str(path) in errors
    assert message in errors


def test_a_threshold_has_no_meaning_for_sums(tmp_path, capsys):
    for text, contents in ((MONITOR, "sums"), (SAFEPO, "means of epochs")):
        path = tmp_path / "log.csv"
        path.write_text(text)
        with pytest.raises(SystemExit):
            main([str(path), "--threshold", "0.5"])
        assert f"holds {contents}, not costs of steps" in capsys.readouterr().err


def test_the_panel_of_costs_of_steps(tmp_path, capsys):
    np.save(tmp_path / "costs.npy", [[0, 1, 1, 0], [1, 1, 1, 0], [0, 0, 0, 0.5]])
    rows, lines, _ = table(capsys, tmp_path / "costs.npy", "--limit", 1, "--alpha", 1, status=0)
    by_name = {row["measure"]: row for row in rows}
    assert by_name["EMCC (α = 1)"] == {
        "measure": "EMCC (α = 1)", "all": "0.500",
        "0 to 33 %": "0.500", "33 to 66 %": "0.750", "66 to 99 %": "0.250",
    }  # fmt: skip
    assert by_name["violation rate V"]["all"] == "0.667"
    assert by_name["cost regret"]["all"] == "3.0"
    assert "costs during training, limit 1; 3 episodes, 12 steps" in lines[0]
    main([str(tmp_path / "costs.npy"), "--limit", "1", "--format", "latex"])
    latex = capsys.readouterr().out
    assert r"violation rate V & 0.667 & 1.000 & 1.000 & 0.000 \\" in latex


def test_the_panel_of_several_runs(tmp_path, capsys):
    for seed, cost in enumerate([1.0, 3.0]):
        folder = tmp_path / f"seed-{seed}"
        folder.mkdir()
        rows = "".join(f"{k},{10 * k},10,0.0,{cost},1,1,1\n" for k in range(9))
        header = "rollout,start_step,length,return,cost,longest_streak,cost_steps,streaks\n"
        (folder / "episodes.csv").write_text(header + rows)
        (folder / "config.json").write_text(f'{{"algorithm": "cpo", "task": "t", "seed": {seed}}}')
    rows, lines, _ = table(capsys, tmp_path, "--limit", 2, "--per-run", status=0)
    assert lines[0].startswith("# cpo on t: costs during training, limit 2; means over 2 runs")
    measures = [row for row in rows if row["measure"] == "violation rate V"]
    assert [row["all"] for row in measures] == ["0.500 range 0.000 to 1.000", "0.000", "1.000"]
    assert any(line.startswith("# cpo on t, seed 1:") for line in lines)
    (row, *_), lines, _ = table(capsys, tmp_path, "--limit", 2, "--total-steps", 200, status=1)
    assert row["66 to 99 %"] == "–"
    assert any("is unfinished: 90 of 200 steps" in line for line in lines)
    assert any("no rollout yet for EMCC_0.99" in line for line in lines)


def test_a_limit_that_is_none(tmp_path, capsys):
    np.save(tmp_path / "costs.npy", [[0.0, 1.0]])
    with pytest.raises(SystemExit):
        main([str(tmp_path / "costs.npy"), "--limit", "-1"])
    assert "limit must be >= 0, got -1.0" in capsys.readouterr().err
