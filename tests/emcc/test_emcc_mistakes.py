"""python -m emcc: mistakes."""

import json

import numpy as np
import pytest

import emcc
from emcc.__main__ import main


def mistakes(tmp):
    """Arguments, and what the message must say."""
    records = emcc.EpisodeRecords.from_costs(np.ones(90), [10] * 9)
    configs = {"run": None, "bad_config": [1], "bad_steps": {"steps": "many"}}
    for name, config in configs.items():
        (tmp / name).mkdir()
        records.save(tmp / name / "episodes.csv")
        if config is not None:
            (tmp / name / "config.json").write_text(json.dumps(config))
    for name, text in {
        "other.csv": "reward\n1\n",
        "damaged.csv": "rollout,start_step,length,return,cost,longest_streak\n0,0,x,0,0,0\n",
        "negative.csv": "cost\n-1\n",
        "text.csv": "cost\nhigh\n",
        "mixed.csv": "episode,cost\n0,1\n1,1\n0,1\n",
        "no_steps.csv": "cost\n",
        "sums.csv": "cost,length\n5,10\n",
        "real_sums.csv": "cost,length\n0.5,10\n",
        "no.npy": "nothing",
    }.items():
        (tmp / name).write_text(text)
    np.savez(tmp / "no_costs.npz", other=[1.0])
    np.savez(tmp / "lengths.npz", costs=[1.0, 0.0], lengths=[1])
    (tmp / "folder").mkdir()
    return [
        (["missing"], "missing: no such file or folder"),
        (["folder"], "no episodes.csv in this folder"),
        (["other.csv"], "other.csv: has the columns reward; needed is cost"),
        (["damaged.csv"], "damaged.csv, line 2, column length: 'x' is not a whole number"),
        (["negative.csv"], "negative.csv: costs must be finite and >= 0, got -1.0 at index 0"),
        (["text.csv"], "text.csv, line 2, column cost: 'high' is not a number"),
        (["mixed.csv"], "mixed.csv: the steps of an episode must follow one another"),
        (["no_steps.csv"], "no_steps.csv: no steps"),
        (["real_sums.csv"], "real_sums.csv: sums of 0/1 costs are needed"),
        (["no.npy"], "no.npy: not a numpy file"),
        (["no_costs.npz"], "no_costs.npz: has the arrays other; needed is costs"),
        (["lengths.npz"], "lengths.npz: lengths add up to 1 steps, but there are 2 costs"),
        (["bad_config"], "config.json: must be a JSON object, got list"),
        (["bad_steps"], "config.json: steps must be a whole number >= 1, got 'many'"),
        (["run", "--alpha", "0"], "alpha must be in (0, 1], got 0.0"),
        (["run", "--ties", "some"], "argument --ties: invalid choice: 'some'"),
        (["run", "--threshold", "1"], "holds streaks, not costs of steps"),
        (["sums.csv", "--threshold", "1"], "sums.csv: holds sums, not costs of steps"),
        (["run", "--total-steps", "50"], "start_steps must be finite and in [0, 49]"),
        (["run", "--total-steps", "0"], "total_steps must be >= 1, got 0"),
        ([], "the following arguments are required: PATH"),
    ]


def test_a_mistake_is_one_line_and_status_2(tmp_path, capsys, monkeypatch):
    cases = mistakes(tmp_path)
    monkeypatch.chdir(tmp_path)
    for arguments, message in cases:
        with pytest.raises(SystemExit) as stop:
            main(arguments)
        output, errors = capsys.readouterr()
        assert (stop.value.code, output) == (2, ""), arguments
        assert message in errors
        assert errors.startswith("python -m emcc: error: ")
        assert errors.count("\n") == 1
