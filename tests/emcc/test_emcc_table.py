"""python -m emcc: what it prints for every kind of input."""

import csv
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import emcc
from emcc.__main__ import main

PARTS = ("EMCC_0.33", "EMCC_0.66", "EMCC_0.99")


def write_run(folder, mcc_values, config=None, length=10):
    """One episode per rollout, with one streak and nothing else."""
    folder.mkdir(parents=True)
    count = len(mcc_values)
    streaks = np.round(np.array(mcc_values) * length).astype(int)
    starts = np.arange(count) * length
    records = emcc.EpisodeRecords(
        *(np.arange(count), starts, np.full(count, length)), np.zeros(count), streaks, streaks
    )
    records.save(folder / "episodes.csv")
    if config is not None:
        (folder / "config.json").write_text(json.dumps(config))
    return folder


def table(capsys, *arguments, status=0):
    """The rows of the CSV form, each by the head's names; and the lines of comments."""
    assert main([*map(str, arguments), "--format", "csv"]) == status
    lines = capsys.readouterr().out.splitlines()
    comments = [line for line in lines if line.startswith("#")]
    return list(csv.DictReader(line for line in lines if not line.startswith("#"))), comments


NINE = [0.1, 0.2, 0.6, 0.2, 0.3, 0.3, 0.0, 0.1, 0.9, 0.0]  # of 10 rollouts, at 0 %, 10 %, ...
# [0, 33 %) has four, [33 %, 66 %) three, [66 %, 99 %] three of them.


def test_a_run_folder(tmp_path, capsys):
    config = {"task": "Circle2D-1-v0", "algorithm": "sac-lb", "seed": 0, "steps": 100}
    write_run(tmp_path / "a", NINE, config)
    (row,), (caption,) = table(capsys, tmp_path, "--alpha", 1)
    assert row == {
        "task": "Circle2D-1-v0", "algorithm": "sac-lb", "runs": "1",
        "steps": "100", "steps from": "config.json", "cost rate": "0.270",
        "EMCC_0.33": "0.275", "EMCC_0.66": "0.200", "EMCC_0.99": "0.333",
    }  # fmt: skip
    assert "alpha = 1, ties = all" in caption


def test_alpha_and_ties_are_used_and_named(tmp_path, capsys):
    write_run(tmp_path / "a", NINE)
    (row,), _ = table(capsys, tmp_path)  # alpha 0.1: of so few values the largest
    assert [row[part] for part in PARTS] == ["0.600", "0.300", "0.900"]
    (row,), (caption,) = table(capsys, tmp_path, "--alpha", 0.5, "--ties", "split")
    assert [row[part] for part in PARTS] == ["0.400", "0.300", "0.633"]
    assert "alpha = 0.5, ties = split" in caption


def test_seeds_make_one_row_with_a_range(tmp_path, capsys):
    for seed, value in enumerate([0.2, 0.4, 0.6]):
        config = {"task": "t", "algorithm": "cpo", "seed": seed}
        write_run(tmp_path / f"s{seed}", [value] * 10, config)
    rows, (caption,) = table(capsys, tmp_path, "--per-run")
    assert "or the range of fewer than" in caption
    assert [row["runs"] for row in rows] == ["3", "seed 0", "seed 1", "seed 2"]
    assert rows[0]["EMCC_0.33"] == "0.400 range 0.200 to 0.600"
    assert [row["EMCC_0.33"] for row in rows[1:]] == ["0.200", "0.400", "0.600"]
    assert rows[0]["steps from"] == "recorded"


def test_five_seeds_make_a_row_with_the_t_interval(tmp_path, capsys):
    pytest.importorskip("scipy", minversion="1.15")
    for seed, value in enumerate([0.2, 0.4, 0.6, 0.7, 0.9]):
        write_run(tmp_path / f"s{seed}", [value] * 10, {"algorithm": "cpo", "seed": seed})
    (row,), (caption,) = table(capsys, tmp_path)
    assert row["EMCC_0.33"] == "0.560 [0.225, 0.895]"
    assert "[95 % t interval], or the range of fewer than 5 runs" in caption
    _, (caption,) = table(capsys, tmp_path, "--limit", 5)
    assert "means over 5 runs [95 % t interval], or the range of fewer than 5 runs" in caption


def test_the_seed_decides_the_interval_without_scipy(tmp_path, capsys, monkeypatch):
    for name in ("scipy", "scipy.special"):
        monkeypatch.setitem(sys.modules, name, None)
    values = np.random.default_rng(0).random(10)
    for seed, value in enumerate(values):
        write_run(tmp_path / f"s{seed}", [value] * 10, {"algorithm": "cpo"}, length=10_000)
    default, same, other = (
        table(capsys, tmp_path, *to)[0] for to in ([], ["--seed", 0], ["--seed", 1])
    )
    assert default == same != other


def test_a_run_that_has_only_just_begun(tmp_path, capsys):
    write_run(tmp_path / "a", [], {"task": "t", "algorithm": "cpo", "steps": 100})
    (row,), comments = table(capsys, tmp_path, status=1)
    assert {row[name] for name in (*PARTS, "cost rate")} == {"\N{EN DASH}"}
    assert any("a/episodes.csv is unfinished: 0 of 100 steps" in line for line in comments)


def test_algorithms_and_tasks_are_apart(tmp_path, capsys):
    for name, task, algorithm in (("a", "t", "cpo"), ("b", "t", "sac"), ("c", "u", "cpo")):
        write_run(tmp_path / name, NINE, {"task": task, "algorithm": algorithm})
    write_run(tmp_path / "d", NINE)
    write_run(tmp_path / "e", NINE)
    rows, _ = table(capsys, tmp_path)
    assert [(row["task"], row["algorithm"]) for row in rows[:3]] == [
        ("t", "cpo"), ("t", "sac"), ("u", "cpo")
    ]  # fmt: skip
    assert [row["algorithm"] for row in rows[3:]] == [
        str(tmp_path / name / "episodes.csv") for name in "de"
    ]


def test_settings_that_differ_are_named(tmp_path, capsys):
    for name, settings in (("a", {"lr": 1, "n": 2}), ("b", {"lr": 3, "n": 2}), ("c", {"lr": 1})):
        config = {"task": "t", "algorithm": "cpo", "hyperparameters": settings, "seed": 0}
        write_run(tmp_path / name, NINE, config)
    config = {"task": "t", "algorithm": "sac", "hyperparameters": {"lr": 7}, "seed": 0}
    write_run(tmp_path / "d", NINE, config)
    rows, _ = table(capsys, tmp_path)
    names = ["cpo (lr 1, n 2)", "cpo (lr 3, n 2)", "cpo (lr 1)", "sac"]
    assert [row["algorithm"] for row in rows] == names
    for name, settings in (("x", "lr=3"), ("y", None)):  # as somebody else may write them
        config = {"task": "u", "algorithm": "ppo", "hyperparameters": settings, "seed": 0}
        write_run(tmp_path / name, NINE, config)
    rows, _ = table(capsys, tmp_path / "x", tmp_path / "y")
    names = ["ppo (hyperparameters lr=3)", "ppo (hyperparameters None)"]
    assert [row["algorithm"] for row in rows] == names


def test_runs_of_other_planned_lengths_are_apart(tmp_path, capsys):
    """Thirds of a long and of a short training are no two values of one mean."""
    for name, values, steps in (("a", [0.9] * 20, 200), ("b", [0.1] * 10, 100), ("c", NINE, 100)):
        config = {"task": "t", "algorithm": "cpo", "seed": name, "steps": steps}
        write_run(tmp_path / name, values, config | {"hyperparameters": {"lr": 1}})
    rows, _ = table(capsys, tmp_path, "--alpha", 1)
    assert [(row["algorithm"], row["runs"], row["EMCC_0.33"]) for row in rows] == [
        ("cpo (total steps 200)", "1", "0.900"),
        ("cpo (total steps 100)", "2", "0.188 range 0.100 to 0.275"),
    ]
    main([str(tmp_path), "--limit", "1"])
    captions = [line for line in capsys.readouterr().out.splitlines() if line.startswith("cpo")]
    assert [line.partition(":")[0] for line in captions] == [
        "cpo (total steps 200) on t", "cpo (total steps 100) on t"
    ]  # fmt: skip


def test_recorded_lengths_that_differ_are_told(tmp_path, capsys):
    for name, values in (("a", [0.9] * 20), ("b", [0.1] * 21)):
        write_run(tmp_path / name, values, {"task": "t", "algorithm": "cpo", "seed": name})
    (row,), (_, note) = table(capsys, tmp_path)
    assert (row["runs"], row["EMCC_0.33"]) == ("2", "0.500 range 0.100 to 0.900")
    assert "t cpo: means over runs of 200 to 210 recorded steps; " in note


def test_runs_of_one_panel_have_one_window(tmp_path, capsys):
    """The row names it: of 4 episodes, since one run has no more. Costs of 9 and 1 in 10 steps."""
    for name, values in (("a", [0.9] * 4 + [0.1] * 6), ("b", [0.1] * 4)):
        write_run(tmp_path / name, values, {"task": "t", "algorithm": "cpo", "seed": name})
    assert main([str(tmp_path), "--limit", "1"]) == 0
    lines = capsys.readouterr().out.splitlines()
    (peak,) = (line for line in lines if line.startswith("peak cost rate (4 episodes)"))
    assert peak.split(")", 1)[1].strip().startswith("0.500 range 0.100 to 0.900")


def test_a_part_without_rollouts_is_no_zero(tmp_path, capsys):
    config = {"task": "t", "algorithm": "cpo", "seed": 0, "steps": 200}
    write_run(tmp_path / "a", NINE, config)
    (row,), comments = table(capsys, tmp_path, "--alpha", 1, status=1)
    assert row["EMCC_0.33"] == f"{np.mean(NINE[:7]):.3f}"
    assert row["EMCC_0.99"] == "\N{EN DASH}"
    assert any("a/episodes.csv is unfinished: 100 of 200 steps" in line for line in comments)
    assert any("a/episodes.csv has no rollout yet for EMCC_0.99." in line for line in comments)


def test_a_mean_over_runs_needs_all_of_them(tmp_path, capsys):
    for name, values in (("a", NINE), ("b", NINE[:5])):
        write_run(tmp_path / name, values, {"task": "t", "algorithm": "cpo", "steps": 100})
    (row,), _ = table(capsys, tmp_path, status=1)
    assert row["EMCC_0.33"] != "\N{EN DASH}"
    assert row["EMCC_0.99"] == "\N{EN DASH}"


def test_total_steps_option_wins(tmp_path, capsys):
    write_run(tmp_path / "a", NINE, {"steps": 200})
    (row,), _ = table(capsys, tmp_path, "--total-steps", 100)
    assert (row["steps"], row["steps from"]) == ("100", "--total-steps")


def test_repeated_seeds_are_noted(tmp_path, capsys):
    for name in "ab":
        write_run(tmp_path / name, NINE, {"task": "t", "algorithm": "cpo", "seed": 4})
    _, comments = table(capsys, tmp_path)
    assert any("2 runs have seed 4" in line for line in comments)


COSTS = np.array([[0, 1, 1, 0], [1, 1, 1, 0], [0, 0, 0, 0.5]])


def write_costs(path):
    lengths = np.full(3, 4)
    if path.suffix == ".npy":
        np.save(path, COSTS)
    elif path.suffix == ".npz":
        np.savez(path, costs=COSTS.ravel(), lengths=lengths)
    else:
        pairs = zip(np.repeat([7, 8, 9], lengths), COSTS.ravel(), strict=True)
        path.write_text("episode,cost\n" + "".join(f"{e},{c}\n" for e, c in pairs))
    return path


@pytest.mark.parametrize("name", ["c.npy", "c.npz", "c.csv"])
def test_costs_of_steps(tmp_path, capsys, name):
    """Three episodes of four steps, which start at 0, 33.3 and 66.7 %."""
    path = write_costs(tmp_path / name)
    (row,), _ = table(capsys, path, "--alpha", 1)
    assert [row[part] for part in PARTS] == ["0.500", "0.750", "0.250"]
    assert row["cost rate"] == f"{5.5 / 12:.3f}"
    (row,), _ = table(capsys, path, "--alpha", 1, "--threshold", 0.5)
    assert [row[part] for part in PARTS] == ["0.500", "0.750", "0.000"]


def test_costs_of_steps_with_rollouts(tmp_path, capsys):
    """Rollout b cuts episode 1: its two steps are a trajectory of their own."""
    path = tmp_path / "c.csv"
    rows = ["a,0,1", "a,0,0", "a,1,1", "b,1,1", "b,1,0", "b,2,0", "c,3,0", "c,3,0"]
    path.write_text("\n".join(["rollout,episode,cost", *rows]))
    (row,), _ = table(capsys, path, "--alpha", 1)
    assert [row[part] for part in PARTS] == ["1.000", "0.500", "0.000"]


def test_sums_of_episodes_give_bounds_and_no_emcc(tmp_path, capsys):
    path = tmp_path / "sums.csv"
    path.write_text("cost,length\n0,10\n6.0,10\n10,10\n")
    assert main([str(path)]) == 1
    output, errors = capsys.readouterr()
    assert "EMCC_0.33" not in output
    assert output.startswith("Bounds, not EMCC")
    at_least, at_most = (0 + 2 + 10) / 30, (0 + 6 + 10) / 30
    assert f"{at_least:.3f}" in output
    assert f"{at_most:.3f}" in output
    assert errors == f"python -m emcc: {path}: sums of episodes cannot give EMCC\n"


def test_text_is_aligned_and_markdown_is_a_table(tmp_path, capsys):
    write_run(tmp_path / "a", NINE, {"task": "t", "algorithm": "cpo", "seed": 0, "steps": 200})
    main([str(tmp_path)])
    text = capsys.readouterr().out.splitlines()
    head, row = text[2:4]
    assert [head.index(name) for name in ("algorithm", "EMCC_0.33")] == [
        row.index("cpo"), row.index("0.600")
    ]  # fmt: skip
    main([str(tmp_path), "--format", "md"])
    lines = capsys.readouterr().out.splitlines()[2:5]
    assert lines[1].replace(" ", "") == "|---" * 9 + "|"
    assert len({line.count("|") for line in lines}) == 1
    assert len({len(line) for line in lines}) == 1


def test_as_a_command(tmp_path):
    write_run(tmp_path / "a", NINE)
    done = subprocess.run(
        [sys.executable, "-m", "emcc", str(tmp_path)],
        cwd=Path(emcc.__file__).parents[1],
        capture_output=True,
        encoding="utf-8",
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert "EMCC_0.33" in done.stdout
