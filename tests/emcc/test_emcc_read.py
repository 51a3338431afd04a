"""Layouts of CSV files: which give EMCC, and equal numbers; which are refused, and why."""

import csv

import numpy as np
import pytest

import emcc
from emcc.__main__ import main

PARTS = ("EMCC_0.33", "EMCC_0.66", "EMCC_0.99")


def episodes(count=200):
    rng = np.random.default_rng(1)
    return [(rng.random(n) < 0.3).astype(int) for n in rng.integers(2, 60, count)]


def streak(costs):
    """The longest streak, by a loop."""
    longest = running = 0
    for cost in costs:
        running = running + 1 if cost else 0
        longest = max(longest, running)
    return longest


def by_hand(costs):
    """EMCC of each third at alpha 0.1: the values that nine tenths of their third do not exceed."""
    total, start, found = sum(map(len, costs)), 0, ([], [], [])
    for of in costs:
        if 100 * start < 99 * total:
            found[100 * start // (33 * total)].append(streak(of) / len(of))
        start += len(of)
    tails = [(sorted(values)[-(-9 * len(values) // 10) - 1], values) for values in found]
    return [np.mean([value for value in values if value >= least]) for least, values in tails]


def write(path, head, rows):
    path.write_text("\n".join([head, *(",".join(map(str, row)) for row in rows)]) + "\n")
    return path


def emcc_of(path, capsys, status=0):
    """The three numbers that the command prints, and its lines of comments."""
    assert main([str(path), "--format", "csv"]) == status
    lines = capsys.readouterr().out.splitlines()
    (row,) = csv.DictReader(line for line in lines if not line.startswith("#"))
    return [row[part] for part in PARTS], [line for line in lines if line.startswith("#")]


def error_of(path, capsys):
    with pytest.raises(SystemExit) as stop:
        main([str(path)])
    output, errors = capsys.readouterr()
    assert (stop.value.code, output, errors.count("\n")) == (2, "", 1)
    return errors


STEPS = [
    (cost, t == len(of) - 1, k) for k, of in enumerate(episodes()) for t, cost in enumerate(of)
]
LAYOUTS = {
    "episode": ("episode,cost", [(k, cost) for cost, _, k in STEPS]),
    "done": ("cost,done", [(cost, int(end)) for cost, end, _ in STEPS]),
    "of numpy": ("cost,done", [(float(cost), float(end)) for cost, end, _ in STEPS]),
    "Python's words": (
        "terminated,cost,truncated",
        [(end and k % 2 == 0, cost, end and k % 2 == 1) for cost, end, k in STEPS],
    ),
    "still running": (
        "cost,done",
        [(cost, int(end and k < STEPS[-1][2])) for cost, end, k in STEPS],
    ),
    "both": ("episode,cost,done", [(k, cost, end) for cost, end, k in STEPS]),
    "episodes that end unmarked": (
        "episode,cost,terminated",
        [(k, cost, end and k % 2 == 0) for cost, end, k in STEPS],
    ),
    "blanks": (" cost , done", [(f" {cost} ", f" {end}") for cost, end, _ in STEPS]),
    "a byte order mark": ("\ufeffcost,done", [(cost, end) for cost, end, _ in STEPS]),
    "empty lines": ("\n\ncost,done", [(cost, f"{end}\n") for cost, end, _ in STEPS]),
}  # fmt: skip


@pytest.mark.parametrize(("head", "rows"), LAYOUTS.values(), ids=LAYOUTS)
def test_costs_of_steps_in_any_layout(tmp_path, capsys, head, rows):
    found, comments = emcc_of(write(tmp_path / "log.csv", head, rows), capsys)
    assert found == [f"{value:.3f}" for value in by_hand(episodes())]
    assert len(comments) == 1  # the caption: nothing was guessed


def test_rollouts_end_where_they_say_and_at_done(tmp_path, capsys):
    rows = ["a,1,0", "a,1,1", "a,0,0", "b,1,0", "b,0,0", "c,0,0", "c,0,1"]
    path = write(tmp_path / "log.csv", "rollout,cost,done", [row.split(",") for row in rows])
    found, _ = emcc_of(path, capsys)
    assert found == ["1.000", "0.500", "0.000"]  # of 2 steps and 1, of 2, of 2


def test_a_file_without_episodes_is_one_episode_and_says_so(tmp_path, capsys):
    path = write(tmp_path / "log.csv", "cost", [[0], [1], [1], [0]])
    found, comments = emcc_of(path, capsys, status=1)
    assert found == ["0.500", "\N{EN DASH}", "\N{EN DASH}"]
    assert f"# Note: {path} has no column episode or done: read as one episode." in comments


@pytest.mark.parametrize("head", ["episode,cost", "rollout,cost"])
def test_a_row_per_episode_is_no_step(tmp_path, capsys, head):
    path = write(tmp_path / "log.csv", head, [(k, k % 7) for k in range(100)])
    assert f"{path}: every episode has one row: these look like sums" in error_of(path, capsys)
    path = write(tmp_path / "log.csv", "cost,done", [(k % 7, 1) for k in range(100)])
    assert "every episode has one row" in error_of(path, capsys)


@pytest.mark.parametrize(
    ("cell", "message"),
    [("2", "must be 0 or 1, got 2"), ("maybe", "'maybe' is not a number"), ("nan", "got nan")],
)
def test_a_flag_that_is_none(tmp_path, capsys, cell, message):
    path = write(tmp_path / "log.csv", "cost,done", [(0, "0"), (0, cell)])
    error = error_of(path, capsys)
    assert f"{path}, line 3, column done: " in error
    assert message in error


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("cost,done,cost,done\n1,0,0,0\n", ": the header names cost, done more than once"),
        ("cost,done, cost\n1,0,0\n", ": the header names cost more than once"),
        ("episode,cost,done\n7,1,0\n7,1,1\n7,0,0\n", ", line 3: the last step of an episode by"),
        ("episode,cost,done\n7,1,0\n\n7,1,1\n7,0,0\n", "but the next line has the episode '7' too"),
        ("rollout,episode,cost,done\n0,7,1,1\n0,7,1,1\n", ", line 2: the last step of an episode"),
        ("episode,cost,done\n0,1,?\n0,1,1\n", ", line 2, column done: '?' is not a number"),
        ("cost,done\n1,0\n\n\n1,x\n", ", line 5, column done: 'x' is not a number"),
        ("cost,length,longest_streak\n\n3,2,3\n", ", line 3, column longest_streak: 3 must be in"),
        ("\n\n", ": the file is empty; a header line is needed"),
    ],
)  # fmt: skip
def test_tables_that_say_two_things(tmp_path, capsys, text, message):
    path = tmp_path / "log.csv"
    path.write_text(text)
    error = error_of(path, capsys)
    assert str(path) in error
    assert message in error


def test_costs_of_several_runs_are_not_one(tmp_path, capsys):
    path = tmp_path / "costs.npy"
    np.save(path, np.zeros((3, 20, 5)))
    needed = "costs must be [steps] or [episodes, steps] of one run, got shape [3, 20, 5]"
    assert f"{path}: {needed}" in error_of(path, capsys)
    np.savez(tmp_path / "costs.npz", costs=np.zeros((3, 20, 5)), lengths=[5] * 60)
    assert needed in error_of(tmp_path / "costs.npz", capsys)


def test_arrays_of_ends_are_not_passed_over(tmp_path, capsys):
    path = tmp_path / "costs.npz"
    np.savez(path, costs=np.ones(4), dones=[0, 1, 0, 1], rewards=np.ones(4))
    assert "the ends of episodes are not read from the array dones" in error_of(path, capsys)
    np.savez(path, costs=np.ones(4), dones=[0, 1, 0, 1], lengths=[2, 2])
    assert emcc.read(path).longest_streak.tolist() == [2, 2]


def test_python_is_told_too_where_a_file_was_read_by_a_guess(tmp_path):
    path = write(tmp_path / "log.csv", "cost", [[0], [1], [1], [0]])
    with pytest.warns(UserWarning, match="no column episode or done: read as one episode") as told:
        assert emcc.read(path).longest_streak == [2]
    assert told[0].filename == __file__


SUMS = [(sum(of), len(of), streak(of)) for of in episodes()]


@pytest.mark.parametrize(
    ("head", "columns"),
    [
        ("cost,length,longest_streak", (0, 1, 2)),
        ("longest_streak,return,length,cost", (2, 0, 1, 0)),
    ],
)
def test_a_row_per_episode_with_its_streak(tmp_path, capsys, head, columns):
    rows = [[of[k] for k in columns] for of in SUMS]
    found, _ = emcc_of(write(tmp_path / "log.csv", head, rows), capsys)
    assert found == [f"{value:.3f}" for value in by_hand(episodes())]


@pytest.mark.parametrize(
    ("head", "row", "message"),
    [
        ("cost,length,longest_streak", (3, 2, 3), ", line 3, column longest_streak: 3 must be in"),
        ("cost,length,longest_streak", (0, -9, 0), ", line 3, column length: -9 must be >= 1"),
        ("cost,length,longest_streak", (0, "x", 0), ", line 3, column length: 'x' is not a whole"),
        ("cost,length,longest_streak,streaks", (1, 2, 1, 1), ": cost_steps and streaks must be"),
        ("rollout,cost,length,longest_streak", (0, 1, 2, 1), ": the header must be rollout,"),
        ("length,longest_streak", (2, 1), ": the header must be rollout,"),
    ],
)
def test_a_row_per_episode_that_is_wrong(tmp_path, capsys, head, row, message):
    path = write(tmp_path / "log.csv", head, [[1] * len(row), row, [1] * len(row)])
    assert f"{path}{message}" in error_of(path, capsys)


def test_records_from_python(tmp_path):
    head, rows = LAYOUTS["done"]
    for path in (write(tmp_path / "log.csv", head, rows), str(tmp_path / "log.csv")):
        records = emcc.read(path)
        assert list(records.emcc_by_part().values()) == pytest.approx(
            by_hand(episodes()), rel=1e-12
        )
    (tmp_path / "run").mkdir()
    records.save(tmp_path / "run" / "episodes.csv")
    assert emcc.read(tmp_path / "run").to_csv() == records.to_csv()
    np.save(tmp_path / "costs.npy", [0.5, 1.0, 1.0, 0.0])
    streaks = [
        emcc.read(tmp_path / "costs.npy", threshold).longest_streak for threshold in (0, 0.5)
    ]
    assert streaks == [[3], [2]]


def test_files_that_are_no_records(tmp_path):
    sums = write(tmp_path / "sums.csv", "cost,length", [(2, 3)])
    with pytest.raises(ValueError, match=r"sums\.csv: sums of episodes cannot give EMCC"):
        emcc.read(sums)
    head = "Metrics/EpCost,Metrics/EpLen,TotalEnvSteps"
    write(tmp_path / "progress.csv", head, [(2, 3, 30)])
    with pytest.raises(ValueError, match=r"progress\.csv: means of epochs cannot give EMCC"):
        emcc.read(tmp_path)
    for name in "ab":
        (tmp_path / name).mkdir()
        (tmp_path / name / "episodes.csv").touch()
    with pytest.raises(ValueError, match="one run is needed, but there are 2: "):
        emcc.read(tmp_path)
    with pytest.raises(ValueError, match="nowhere: no such file or folder"):
        emcc.read(tmp_path / "nowhere")
