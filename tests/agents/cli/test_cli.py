"""The command line: commands, their output, their files and their exit status."""

import re
import shutil
import sys

import numpy as np
import pytest

import agents
from agents.cli.main import main
from agents.training import loop as train_module
from agents.training.files import locked
from agents.training.status import share_done

TRAIN = ["train", "--algorithm", "sac-lag", "--seeds", "0", "1", "--steps", "600"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("runs") / "first"
    assert main([*TRAIN, "--out", str(path), "--random-steps", "300"]) == 0
    return path


def test_train_prints_and_writes_the_table(folder, capsys):
    assert main(["report", str(folder)]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    written = (folder / "report.md").read_text()
    assert written.startswith(f"## Circle2D-1-v0\n\n{out.rstrip()}\n")
    rows = [line for line in out.splitlines() if line.startswith("| SAC-Lag")]
    names = [row.split("|")[1].strip() for row in rows]
    assert names == [
        "SAC-Lag (random_steps 300, 600 steps), mean of 2",
        "SAC-Lag, paper (3 seeds)",
        "SAC-Lag (random_steps 300, 600 steps), seed 0",
        "SAC-Lag (random_steps 300, 600 steps), seed 1",
    ]
    paper = [cell.strip() for cell in rows[1].split("|")[2:9]]
    assert paper == ["0.62", "0.63", "0.43", "0.20", "-13.70", "3.32", "3.64"]
    assert "The paper does not print this choice" in out
    assert (folder / "report.csv").read_text().count("SAC-Lag") >= 4
    assert share_done(folder) == 1.0
    assert not (folder / "timing.log").exists()


def test_evaluate(folder, capsys):
    assert main(["evaluate", str(folder), "--episodes", "7"]) == 0
    assert "7 episodes" in capsys.readouterr().out


def test_resume_of_a_finished_run_changes_nothing(folder, capsys):
    before = (folder / "checkpoint.npz").read_bytes()
    assert main(["resume", str(folder)]) == 0
    assert (folder / "checkpoint.npz").read_bytes() == before
    assert f"{folder}: was done already: evaluated again\n" in capsys.readouterr().err


def test_hyperparameters_and_task_parameters(tmp_path):
    from agents.training.config import TrainConfig

    out = tmp_path / "x"
    options = ["--cost-limit", "3", "--hidden", "32", "--time-limit", "bootstrap"]
    task = ["--task", "Circle2D-3-v0", "--task-parameters", "constraint_radius", "3.0"]
    steps = ["--steps", "150", "--seeds", "4"]
    arguments = ["train", "--algorithm", "sac-lag", *task, *options, *steps, "--out", str(out)]
    assert main(arguments) == 0
    config = TrainConfig.read(out)
    assert config.task_parameters == {"constraint_radius": 3.0}
    assert config.hyperparameters.cost_limit == 3.0
    assert config.hyperparameters.hidden == (32,)
    assert config.hyperparameters.time_limit == "bootstrap"
    assert config.seeds == (4,)


def test_counts_may_be_written_as_1e6_and_the_newest_version_of_a_task_is_found(tmp_path):
    from agents.training.config import TrainConfig

    arguments = ["train", "--algorithm", "sac-lag", "--task", "Circle2D-3", "--steps", "2e2"]
    arguments += ["--seeds", "0", "--replay-size", "2e4", "--out", str(tmp_path / "x")]
    assert main(arguments) == 0
    config = TrainConfig.read(tmp_path / "x")
    assert config.task == "Circle2D-3-v0"
    assert type(config.steps) is int
    assert (config.steps, config.hyperparameters.replay_size) == (200, 20_000)


def test_help_explains_every_option(capsys):
    with pytest.raises(SystemExit) as done:
        main(["train", "--algorithm", "sac-lag", "--help"])
    assert done.value.code == 0
    text = re.sub(r"[│\s]+", " ", capsys.readouterr().out)
    for option in ("--seeds", "--steps", "--cost-limit", "--multiplier-lr", "--time-limit"):
        assert option in text
    assert "Limit d of the discounted cost return" in text
    assert "(default: 5.0)" in text
    assert main(["--help"]) == 0
    assert main([]) == 2


def test_help_without_an_algorithm_explains_those_of_all(capsys):
    assert main(["train", "--help"]) == 0
    out = capsys.readouterr().out
    for option in ("--seeds", "--cg-damping", "--log-barrier-factor", "--risk-level"):
        assert option in out


def test_a_failed_run_is_named_and_the_status_is_1(tmp_path, capsys, monkeypatch):
    run_epoch = train_module.run_epoch

    def poisoned(trainings):
        [training] = trainings
        if training.epoch == 5:
            training.learner._state.actor[1, 0] = np.nan
        run_epoch(trainings)

    monkeypatch.setattr(train_module, "run_epoch", poisoned)
    out = tmp_path / "runs"
    options = ["--algorithm", "sac-lb", "--seeds", "3", "4", "5", "--random-steps", "0"]
    assert main(["train", *options, "--steps", "600", "--out", str(out)]) == 1
    table, err = capsys.readouterr()
    # NaN actions void the sixth episode at its first step.
    assert err.splitlines()[-1] == (
        f"circle2d: {out}: seed 4 failed at step 250: it met a NaN or an infinite number"
    )
    assert "seed-4: failed at step 250" in table
    assert "mean of 2" in table
    assert "seed 4 |" not in table
    assert main(["resume", str(out)]) == 1
    assert main(["evaluate", str(out), "--episodes", "2"]) == 1
    said = capsys.readouterr().out
    assert f"{out}, after 600 of 600 steps: " in said  # those that are evaluated
    assert said.count("seed 4, ") == said.count("no finite numbers") == 2


def test_tensorboard_where_it_is_missing(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    assert main([*TRAIN, "--out", str(tmp_path / "x"), "--tensorboard"]) == 2
    assert "pip install 'circle2d-mj[tensorboard]'" in capsys.readouterr().err
    assert not (tmp_path / "x").exists()


def test_report_names_what_it_leaves_out(folder, tmp_path, capsys):
    copy = tmp_path / "runs"
    shutil.copytree(folder, copy)
    episodes = copy / "seed-0" / "episodes.csv"
    episodes.write_text(episodes.read_text()[:-100])
    assert main(["report", str(copy)]) == 1
    out = capsys.readouterr().out
    assert "(random_steps 300, 600 steps), mean of 1" in out
    assert "seed 0 |" not in out
    assert re.search(r"left out: .*seed-0: .*episodes\.csv", out)
    (copy / "seed-1" / "evaluation.json").unlink()
    assert main(["report", str(copy)]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert "holds no complete runs" in err
    assert re.search(r"left out: .*seed-1: .*evaluation\.json is missing", err)


def test_one_damaged_folder_does_not_hide_the_others(folder, tmp_path, capsys):
    shutil.copytree(folder, tmp_path / "good")
    shutil.copytree(folder, tmp_path / "bad")
    (tmp_path / "bad" / "config.json").write_text("{")
    (tmp_path / "foreign").mkdir()
    (tmp_path / "foreign" / "config.json").write_text("[1, 2]")
    shutil.copytree(folder, tmp_path / "elsewhere")  # with a task that cannot be found here
    (tmp_path / "elsewhere" / "checksums.json").unlink()
    config = tmp_path / "elsewhere" / "config.json"
    config.write_text(config.read_text().replace("Circle2D-1-v0", "no_such_module:Mine-v0"))
    assert main(["report", str(tmp_path)]) == 1
    out = capsys.readouterr().out
    assert "mean of 2" in out
    assert len(re.findall("left out", out)) == 2
    assert "no_such_module:Mine-v0" in out  # numbers need no module


def test_no_table_of_a_very_short_run_but_its_evaluation(tmp_path, capsys):
    out = str(tmp_path / "x")
    agents.train("sac-lag", seeds=0, steps=1, out=out)  # the command refuses it
    assert main(["resume", out]) == 0
    assert "no table" in capsys.readouterr().err
    assert main(["report", out]) == 2
    assert main(["evaluate", out, "--episodes", "2"]) == 0
    assert "seed 0, deterministic policy: J_R -" in capsys.readouterr().out


def test_two_processes_do_not_train_in_one_folder(folder, capsys):
    with locked(folder):
        assert main(["resume", str(folder)]) == 2
    assert "another process is training" in capsys.readouterr().err


def test_the_machine_refuses(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert main([*TRAIN, "--out", str(tmp_path / "file" / "x")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
