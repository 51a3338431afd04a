"""One process at a time in a folder; records that can be written again."""

import subprocess
import sys
import time

import pytest
from small_runs import results

import agents
from agents.cli.main import main
from agents.errors import UserError
from agents.training import loop
from agents.training.evaluation import evaluate
from agents.training.files import locked, read_json
from agents.training.loop import evaluate_checkpoint, load_training

OPTIONS = {"random_steps": 50, "gradient_steps": 1, "checkpoint_every": 100}


def trained(out, steps=200, **more):
    return agents.train("sac-lag", seeds=[0, 1], steps=steps, out=out, **OPTIONS, **more).folder


HOLDER = """
import sys
if sys.argv[2] == "without":
    sys.modules["fcntl"] = None
from pathlib import Path
from agents.training.files import locked
with locked(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.readline()
"""


def hold(folder, how):
    command = [sys.executable, "-W", "error", "-c", HOLDER, str(folder), how]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen(command, text=True, **pipes)


@pytest.mark.parametrize("how", ["with", "without"])
def test_a_lock_with_and_without_fcntl(tmp_path, how):
    """A second process is refused; a killed one holds nothing."""
    first = hold(tmp_path, how)
    assert first.stdout.readline() == "held\n"
    second = hold(tmp_path, how)
    assert second.stdout.readline() == ""
    assert f"another process is training or evaluating in {tmp_path}" in second.communicate()[1]
    first.kill()
    first.communicate()
    third = hold(tmp_path, how)
    assert third.stdout.readline() == "held\n"
    third.communicate("done\n")
    assert third.returncode == 0
    fourth = hold(tmp_path, how)
    assert fourth.stdout.readline() == "held\n"
    fourth.communicate("done\n")


def test_evaluation_is_refused_while_something_trains(tmp_path, capsys):
    folder = trained(tmp_path / "x")
    before = results(folder)
    with locked(folder):
        assert main(["evaluate", str(folder), "--episodes", "2"]) == 2
        with pytest.raises(UserError, match="another process is training or evaluating"):
            evaluate_checkpoint(folder, 2)
    assert results(folder) == before
    assert "another process" in capsys.readouterr().err
    with pytest.raises(UserError, match="is no folder"):
        evaluate_checkpoint(tmp_path / "nowhere", 2)
    assert not (tmp_path / "nowhere").exists()


def test_nothing_trains_while_an_evaluation_plays(tmp_path, monkeypatch):
    """So that its result, begun with an earlier policy, is never that of a later one."""
    folder = trained(tmp_path / "x", on_epoch=lambda epoch: epoch.runs[0]["step"] < 100)
    refused = []

    def slowly(*args):
        try:
            agents.resume(folder)
        except UserError as error:
            refused.append(str(error))
        return evaluate(*args)

    monkeypatch.setattr(loop, "evaluate", slowly)
    evaluate_checkpoint(folder, 3)
    monkeypatch.undo()
    assert len(refused) == 1
    assert read_json(folder / "seed-0" / "evaluation.json")["episodes"] == 3
    agents.resume(folder)
    assert read_json(folder / "seed-0" / "evaluation.json")["episodes"] == 100
    assert results(folder) == results(trained(tmp_path / "whole"))


def test_resume_of_a_finished_run_writes_its_records_again(tmp_path):
    folder = trained(tmp_path / "x")
    expected = results(folder)
    (folder / "seed-0" / "episodes.csv").unlink()
    (folder / "seed-1" / "episodes.csv").write_text("torn")
    (folder / "seed-1" / "updates.csv").write_text("")
    (folder / "seed-0" / "evaluation.json").unlink()
    agents.resume(folder)
    assert results(folder) == expected
    assert load_training(folder).done


def test_two_trainings_into_one_folder_at_once(tmp_path):
    """The second is refused, and nothing of the first is touched."""
    expected = {s: results(trained_with(tmp_path / f"alone{s}", s)) for s in (0, 5)}
    folder = tmp_path / "x"
    options = ["--algorithm", "sac-lag", "--steps", "200", "--checkpoint-every", "100"]
    options += ["--random-steps", "50", "--gradient-steps", "1", "--backend", "eager"]
    command = [sys.executable, "-m", "agents.cli", "train", *options, "--out", str(folder)]
    processes = {
        seed: subprocess.Popen(
            [*command, "--seeds", str(seed)], stderr=subprocess.PIPE, stdout=subprocess.DEVNULL
        )
        for seed in (0, 5)
    }
    deadline = time.monotonic() + 300
    for process in processes.values():
        process.communicate(timeout=deadline - time.monotonic())
    codes = {seed: process.returncode for seed, process in processes.items()}
    assert sorted(codes.values()) == [0, 2]
    [first] = [seed for seed, code in codes.items() if code == 0]
    left = {k: v for k, v in results(folder).items() if not k.startswith("report")}
    assert left == expected[first]


def trained_with(out, seed):
    return agents.train("sac-lag", seeds=seed, steps=200, out=out, **OPTIONS).folder
