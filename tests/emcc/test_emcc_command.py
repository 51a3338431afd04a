"""`python -m emcc`: tables of run folders and files, exit statuses, and errors."""

import csv
import io
import re
import sys

import numpy as np
import pytest
import written

import emcc
from emcc.__main__ import main

PARTS = ("EMCC_0.33", "EMCC_0.66", "EMCC_0.99")
DASH = "\N{EN DASH}"
TEN = [0.1, 0.2, 0.6, 0.2, 0.3, 0.3, 0.0, 0.1, 0.9, 0.0]
"""MCC of ten rollouts, which start at 0 %, 10 %, ... of training: four in the first third, three in
each of the others."""


def costs_of(mcc_values):
    """Return an episode of 10 steps for each MCC, whose cost steps are one streak."""
    return [np.arange(10) < round(10 * value) for value in mcc_values]


def write_run(folder, by_seed, steps=100, task="A-v0"):
    runs = {(task, seed): written.arrays_of(costs_of(mcc)) for seed, mcc in by_seed.items()}
    return written.write_run(folder, runs, steps=steps)


def table(capsys, *arguments, status=0):
    """Run the command with `--format csv`; return its rows, by column, and its comment lines."""
    assert main([*map(str, arguments), "--format", "csv"]) == status
    lines = capsys.readouterr().out.splitlines()
    comments = [line for line in lines if line.startswith("#")]
    return list(csv.DictReader(line for line in lines if not line.startswith("#"))), comments


def test_a_run(tmp_path, capsys):
    folder = write_run(tmp_path / "a", {0: TEN})
    (row,), (caption,) = table(capsys, tmp_path, "--alpha", 1)
    assert row == {
        "source": str(folder), "algorithm": "cpo", "task": "A-v0", "seeds": "0", "steps": "100",
        "EMCC_0.33": "0.275", "EMCC_0.66": "0.200", "EMCC_0.99": "0.333", "cost rate": "0.270",
    }  # fmt: skip
    assert "alpha = 1, ties = split" in caption


def test_characters_that_the_encoding_lacks_are_replaced(tmp_path, monkeypatch):
    path = tmp_path / "log.csv"
    path.write_text("episode,cost\n" + "0,1\n0,0\n1,1\n1,0\n2,1\n2,0\n3,1\n3,0\n")
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(io.BytesIO(), encoding="ascii"))
    assert main([str(path)]) == 0
    sys.stdout.flush()
    last = sys.stdout.buffer.getvalue().decode("ascii").splitlines()[-1]
    assert last.split()[1:] == ["?", "?", "?", "8", "0.500", "0.500", "0.500", "0.500"]


def test_alpha_and_ties_are_used_and_named(tmp_path, capsys):
    emcc.EpisodeRecords.from_costs(costs_of(TEN)).save(tmp_path / "a.csv")
    (row,), _ = table(capsys, tmp_path / "a.csv")  # alpha 0.1 of so few values is their maximum
    assert [row[part] for part in PARTS] == ["0.600", "0.300", "0.900"]
    (row,), (caption,) = table(capsys, tmp_path / "a.csv", "--alpha", 0.5)
    assert [row[part] for part in PARTS] == ["0.400", "0.300", "0.633"]
    assert "alpha = 0.5, ties = split" in caption
    (row,), (caption,) = table(capsys, tmp_path / "a.csv", "--alpha", 0.5, "--ties", "all")
    assert [row[part] for part in PARTS] == ["0.333", "0.300", "0.500"]
    assert "alpha = 0.5, ties = all" in caption


def test_windows_are_used_and_named(tmp_path, capsys):
    """Windows of three rollouts start at 0, 30 and 60 % and have the MCCs .6, .3 and .9; the tenth
    rollout is left over. Windows of 20 steps hold two rollouts: .2, .6, .3, .1 and .9."""
    emcc.EpisodeRecords.from_costs(costs_of(TEN)).save(tmp_path / "a.csv")
    how = tmp_path / "a.csv", "--alpha", 1
    (row,), (caption,) = table(capsys, *how, "--window", 3, status=1)
    assert [row[part] for part in PARTS] == ["0.450", "0.900", DASH]
    assert "windows of 3 episodes" in caption
    (row,), (caption,) = table(capsys, *how, "--window-steps", 20)
    assert [row[part] for part in PARTS] == ["0.400", "0.200", "0.900"]
    assert "windows of 20 steps" in caption
    assert main([str(tmp_path / "a.csv"), "--limit", "3", "--window", "3"]) == 1
    told = capsys.readouterr()
    assert "--moving-window" in told.err and "windows of 3 episodes" in told.out


def test_seeds_of_a_folder_make_one_row(tmp_path, capsys):
    write_run(tmp_path / "a", {seed: [value] * 10 for seed, value in enumerate((0.2, 0.4, 0.6))})
    (row,), (caption,) = table(capsys, tmp_path)
    assert (row["seeds"], row["EMCC_0.33"]) == ("0 1 2", "0.400 range 0.200 to 0.600")
    assert "range of fewer than 5 runs" in caption
    (again,), _ = table(capsys, tmp_path, tmp_path / "a")  # paths may overlap
    assert again == row
    rows, _ = table(capsys, tmp_path, "--per-run")
    assert [row["EMCC_0.33"] for row in rows] == ["0.200", "0.400", "0.600"]


def test_five_seeds_have_the_t_interval(tmp_path, capsys):
    pytest.importorskip("scipy", minversion="1.15")
    values = enumerate((0.2, 0.4, 0.6, 0.7, 0.9))
    write_run(tmp_path / "a", {seed: [value] * 10 for seed, value in values})
    (row,), _ = table(capsys, tmp_path)
    assert row["EMCC_0.33"] == "0.560 [0.225, 0.895]"


def test_without_scipy_an_interval_is_refused_and_a_range_is_not(tmp_path, capsys, monkeypatch):
    for name in ("scipy", "scipy.special", "scipy.stats"):
        monkeypatch.setitem(sys.modules, name, None)
    write_run(tmp_path / "three", dict.fromkeys(range(3), TEN))
    assert main([str(tmp_path)]) == 0
    write_run(tmp_path / "five", {seed: [0.1 * seed] * 10 for seed in range(5)})
    with pytest.raises(SystemExit):
        main([str(tmp_path)])
    assert "scipy, which is not installed: pip install scipy" in capsys.readouterr().err


def test_each_folder_task_and_cost_has_a_row(tmp_path, capsys):
    write_run(tmp_path / "a", {0: TEN})
    write_run(tmp_path / "b", {0: TEN}, task="B-v0")
    arrays = written.arrays_of(costs_of(TEN)) | written.arrays_of(costs_of([0.5] * 10), "cost_2")
    both = ["cost", "cost_2"]
    written.write_run(tmp_path / "c", {("A-v0", 1): arrays}, steps=100, costs=both)
    rows, _ = table(capsys, tmp_path)
    assert [row["task"] for row in rows] == ["A-v0", "B-v0", "A-v0", "A-v0 (cost_2)"]
    assert [row["EMCC_0.33"] for row in rows] == ["0.600"] * 3 + ["0.500"]


def test_a_part_without_rollouts_has_a_dash_instead_of_a_number(tmp_path, capsys):
    write_run(tmp_path / "a", {0: TEN}, steps=200)
    (row,), _ = table(capsys, tmp_path, "--alpha", 1, status=1)
    assert row["EMCC_0.33"] == f"{np.mean(TEN[:7]):.3f}"
    assert row["EMCC_0.99"] == DASH
    (row,), _ = table(capsys, tmp_path, "--total-steps", 100)
    assert (row["steps"], row["EMCC_0.99"]) == ("100", "0.900")
    write_run(tmp_path / "b", {0: TEN, 1: TEN[:5]})  # a mean needs all runs
    (row,), _ = table(capsys, tmp_path / "b", status=1)
    assert (row["EMCC_0.33"], row["EMCC_0.99"]) == ("0.600 range 0.600 to 0.600", DASH)


@pytest.mark.parametrize("episodes", [0, 8])
def test_a_run_that_failed_is_left_out_and_named_once(tmp_path, capsys, episodes):
    both = written.arrays_of(costs_of(TEN)) | written.arrays_of(costs_of(TEN), "cost_2")
    failed = {"failure": np.array(f"failed at step {10 * episodes}: its reward is not finite")}
    if episodes:  # with 8 of 10 episodes, every third would have a value
        for cost in ("cost", "cost_2"):
            failed |= written.arrays_of(costs_of([0.3] * episodes), cost)
    runs = {("A-v0", 0): both, ("A-v0", 1): failed}
    written.write_run(tmp_path / "a", runs, steps=100, costs=["cost", "cost_2"])
    for more in ((), ("--limit", "1")):
        assert main([str(tmp_path), *more, "--format", "csv"]) == 1
        out, err = capsys.readouterr()
        assert err == f"left out: {tmp_path / 'a'}, A-v0, seed 1: {failed['failure']}\n"
        assert "0.900" in out  # the late EMCC of the other run
    written.write_run(tmp_path / "b", {("A-v0", 1): failed})
    with pytest.raises(SystemExit):
        main([str(tmp_path / "b")])
    assert str(failed["failure"]) in capsys.readouterr().err


def test_panels(tmp_path, capsys):
    """One window for all runs of a panel: of 4 episodes. Costs of 9 and 1 in 10 steps."""
    write_run(tmp_path / "a", {0: [0.9] * 4 + [0.1] * 6, 1: [0.1] * 4}, steps=40)
    main([str(tmp_path), "--limit", "1", "--total-steps", "100"])
    out = capsys.readouterr().out
    assert out.startswith(f"{tmp_path / 'a'}, cpo, A-v0, seeds 0 1: costs during training")
    assert re.search(r"\npeak cost rate \(4 episodes\) +0.500 range 0.100 to 0.900", out)
    main([str(tmp_path), "--limit", "1", "--total-steps", "100", "--per-run"])
    assert capsys.readouterr().out.count("violation rate V") == 2
    # Three episodes of 100 steps, each of cost 20 and cut into four rollouts.
    rows = [f"{step % 5 == 0:d},{step // 100},{step // 25}" for step in range(300)]
    (path := tmp_path / "cut.csv").write_text("\n".join(["cost,episode,rollout", *rows, ""]))
    main([str(path), "--limit", "10", "--threshold", "0.5"])
    out = re.sub(" +", " ", capsys.readouterr().out)
    assert out.startswith(f"{path}, cost steps above 0.5: costs during training")
    assert "3 episodes, 300 steps" in out and "violation rate V 1.000" in out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere\x1b"], "no such file or folder"),
        (["a", "--alpha", "0"], "alpha must be in (0, 1], got 0.0"),
        (["a", "--ties", "some"], "invalid choice: 'some'"),
        (["a", "--moving-window", "9"], "--moving-window needs --limit"),
        (["a", "--window", "0"], "window must be >= 1, got 0"),
        (["a", "--window", "2", "--window-steps", "9"], "not allowed with argument --window"),
        (
            ["a", "--total-steps", "50"],
            "total_steps must be at least the 100 steps that are recorded, got 50",
        ),
        ([], "the following arguments are required: PATH"),
    ],
)
def test_a_mistake_is_one_line_and_status_2(tmp_path, capsys, monkeypatch, arguments, message):
    write_run(tmp_path / "a", {0: TEN})
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    output, errors = capsys.readouterr()
    assert (stop.value.code, output) == (2, "")
    assert message in errors
    assert errors.startswith("python -m emcc: error: ")
    assert errors.count("\n") == 1
    assert "\x1b" not in errors
