"""Whole trainings: independent of their company, resumable at any moment, whole files."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest
from small_runs import results

from agents.errors import UserError
from agents.paper.presets import preset
from agents.training.config import TrainConfig
from agents.training.evaluation import evaluate
from agents.training.files import read_arrays, read_json, write_whole
from agents.training.loop import Training, load_training, train
from emcc import EpisodeRecords

RESULTS = ("config.json", "episodes.csv", "updates.csv", "evaluation.json")


def config(seeds, steps=1500, task="Circle2D-1-v0", checkpoint_every=500, **changes):
    hyperparameters = replace(preset("sac-lag", task), random_steps=400, **changes)
    return TrainConfig(
        "sac-lag", task, tuple(seeds), steps, hyperparameters, checkpoint_every=checkpoint_every
    )


def trained(folder, *args, **kwargs):
    config(*args, **kwargs).write(folder)
    train(folder)
    return folder


def test_twelve_runs_and_one(tmp_path):
    """Run 7 of twelve leaves the very files that it leaves alone."""
    together = trained(tmp_path / "twelve", range(12), gradient_steps=2)
    alone = trained(tmp_path / "one", [7], gradient_steps=2)
    for name in RESULTS:
        assert (together / "seed-7" / name).read_bytes() == (alone / "seed-7" / name).read_bytes()
    learned = read_arrays(together / "checkpoint.npz")["actor"]
    np.testing.assert_array_equal(learned[7], read_arrays(alone / "checkpoint.npz")["actor"][0])
    assert not np.array_equal(learned[7], learned[8])


def test_equal_runs_leave_equal_files_and_others_do_not(tmp_path):
    first, second = (results(trained(tmp_path / str(k), [0, 1])) for k in range(2))
    assert first == second
    assert first["seed-0/updates.csv"] != first["seed-1/updates.csv"]


def test_episodes_that_end_early(tmp_path):
    """Runs wait for each other behind a mask; each takes its own number of steps."""
    parameters = {"reset_on_cost": True}
    folders = {}
    for name, seeds in (("three", [3, 4, 8]), ("one", [4])):
        folders[name] = tmp_path / name
        replace(config(seeds), task_parameters=parameters).write(folders[name])
        train(folders[name])
    for name in RESULTS:
        files = [folder / "seed-4" / name for folder in folders.values()]
        assert files[0].read_bytes() == files[1].read_bytes()
    records = [EpisodeRecords.load(folders["three"] / f"seed-{s}/episodes.csv") for s in (3, 4, 8)]
    for r in records:
        assert r.length.min() < 50
        np.testing.assert_array_equal(r.start_step, np.cumsum(r.length) - r.length)
        assert 1500 <= r.total_steps < 1550
    assert len({len(r) for r in records}) > 1


KILLED = """
import os, signal, sys
from pathlib import Path
from agents.training.loop import train

epochs = 0
def on_epoch(trainings):
    global epochs
    epochs += 1
    if epochs == int(sys.argv[2]):
        os.kill(os.getpid(), signal.SIGKILL)

train(Path(sys.argv[1]), on_epoch=on_epoch)
"""


def test_killed_twice_and_resumed_is_as_never_killed(tmp_path):
    expected = results(trained(tmp_path / "whole", [0, 1]))
    folder = tmp_path / "killed"
    config([0, 1]).write(folder)
    for epochs in (7, 13):  # before the first checkpoint, and 3 epochs after the one at epoch 10
        done = subprocess.run([sys.executable, "-c", KILLED, str(folder), str(epochs)], check=False)
        assert done.returncode == -signal.SIGKILL
    assert int(read_arrays(folder / "checkpoint.npz")["epoch"]) == 10
    epochs = []
    train(folder, on_epoch=lambda trainings: epochs.append(trainings[0].epoch))
    assert epochs == list(range(11, 31))  # from the checkpoint, not from the start
    assert results(folder) == expected


def test_killed_at_any_moment(tmp_path):
    """Killed from outside, again and again, at whatever it is doing, with a save every epoch."""
    expected = results(trained(tmp_path / "whole", [0], checkpoint_every=50, steps=2000))
    folder = tmp_path / "killed"
    config([0], checkpoint_every=50, steps=2000).write(folder)
    code = "import sys; from pathlib import Path; from agents.training.loop import train\n"
    code += "train(Path(sys.argv[1]), on_epoch=lambda _: print('an epoch', flush=True))"
    rng = np.random.default_rng(0)
    for epochs in (1, 3, 2, 4):  # of 40; each is saved before it is printed
        process = subprocess.Popen(
            [sys.executable, "-c", code, str(folder)], stdout=subprocess.PIPE
        )
        for _ in range(epochs):
            assert process.stdout.readline() == b"an epoch\n"
        time.sleep(rng.uniform(0, 0.05))
        process.kill()
        process.wait()
        process.stdout.close()
        if (folder / "checkpoint.npz").exists():
            load_training(folder)  # whatever was being written, this is whole
    assert (
        load_training(folder).epoch >= 1 + 3 + 2 + 4
    )  # each went on where the one before had come to
    train(folder)
    left = {name: data for name, data in results(folder).items() if "unfinished" not in name}
    assert left == expected


def test_an_evaluation_of_an_earlier_policy_is_not_kept(tmp_path):
    """Whoever finds one beside the last records may take it for that of the last policy."""
    config([0]).write(tmp_path)
    training = Training(config([0]))
    for _ in range(2):
        training.run_epoch()
        training.save(tmp_path)
        assert not (tmp_path / "seed-0" / "evaluation.json").exists()
        evaluate(tmp_path, training.config, training.learner.policy(), 1)
        assert (tmp_path / "seed-0" / "evaluation.json").exists()


def test_write_whole_keeps_the_old_file_when_it_fails(tmp_path, monkeypatch):
    path = tmp_path / "x"
    write_whole(path, "old")
    monkeypatch.setattr(os, "replace", lambda *_: (_ for _ in ()).throw(OSError("disk")))
    with pytest.raises(OSError, match="disk"):
        write_whole(path, "new")
    assert path.read_text() == "old"


def test_what_a_run_leaves_behind(tmp_path):
    folder = trained(tmp_path / "run", [3, 4])
    of_run = read_json(folder / "seed-3/config.json")
    assert (of_run["seed"], of_run["steps"], of_run["task"]) == (3, 1500, "Circle2D-1-v0")
    assert of_run["hyperparameters"]["time_limit"] == "terminal"
    assert set(of_run["versions"]) >= {"python", "torch", "numpy", "gymnasium", "circle2d-mj"}
    records = EpisodeRecords.load(folder / "seed-3/episodes.csv")
    assert records.length.tolist() == [50] * 30
    assert records.start_step.tolist() == list(range(0, 1500, 50))
    updates = np.genfromtxt(folder / "seed-3/updates.csv", delimiter=",", names=True)
    # 256 transitions are there after the sixth episode, which is rollout 5.
    assert updates["rollout"].tolist() == list(range(5, 30))
    assert updates["step"].tolist() == list(range(300, 1501, 50))
    assert np.isfinite(updates.tolist()).all()
    evaluation = read_json(folder / "seed-3/evaluation.json")
    for policy in ("deterministic", "stochastic"):
        result = evaluation[policy]
        assert len(result["returns"]) == len(result["cost_returns"]) == 100
        assert result["J_R"] == pytest.approx(np.mean(result["returns"]))
        assert result["J_C"] == pytest.approx(np.mean(result["cost_returns"]))
        # F⁻¹(0.5) of 100 values is the 50th smallest; all at or above it are kept.
        costs = sorted(result["cost_returns"])
        kept = [c for c in costs if c >= costs[49]]
        assert result["CVaR_0.5"] == pytest.approx(sum(kept) / len(kept))
    assert evaluation["deterministic"]["returns"] != evaluation["stochastic"]["returns"]


def test_random_steps_are_random_and_then_the_policy_acts():
    training = Training(config([0], steps=1500))
    actions = []
    step = training._envs.step
    training._envs.step = lambda action: (actions.append(action.copy()), step(action))[1]
    while training.steps[0] < 450:
        training.run_epoch()
    assert np.abs(np.concatenate(actions[:400])).max() <= 1
    uniform = np.concatenate(actions[:400])
    assert abs(uniform.mean()) < 0.1
    assert abs(uniform.std() - 1 / np.sqrt(3)) < 0.05
    # The policy's action at the first step of its own, from the same noise:
    replayed = Training(config([0], steps=1500))
    replayed.learner.config = replace(replayed.config.hyperparameters, random_steps=10_000)
    while replayed.steps[0] < 450:
        replayed.run_epoch()
    np.testing.assert_array_equal(
        replayed.learner._replay._rows[0, :400, 2:4], np.concatenate(actions[:400])
    )
    assert not np.isin(
        replayed.learner._replay._rows[0, 400:450, 2:4], np.concatenate(actions[400:450])
    ).any()


@pytest.mark.parametrize(("choice", "terminal"), [("terminal", 1.0), ("bootstrap", 0.0)])
def test_time_limit(choice, terminal):
    """Whether step 50, a truncation, is stored as terminal."""
    training = Training(config([0], time_limit=choice))
    for _ in range(3):
        training.run_epoch()
    stored = training.learner._replay._rows[0, :150, -1].reshape(3, 50)
    assert stored[:, -1].tolist() == [terminal] * 3
    assert not stored[:, :-1].any()


def damage_json(path):
    path.write_text(path.read_text()[:40])


def change(path, **arrays):
    np.savez(path, **{**read_arrays(path), **arrays})


def damage_arrays(path):
    path.write_bytes(path.read_bytes()[:1000])


@pytest.mark.parametrize(
    ("name", "damage", "message"),
    [
        ("config.json", damage_json, r"config\.json is damaged"),
        ("config.json", lambda p: p.write_text("[]"), "must be a JSON object"),
        (
            "config.json",
            lambda p: p.write_text("{}"),
            r"config\.json is damaged: 'hyperparameters'",
        ),
        ("config.json", lambda p: p.unlink(), r"config\.json is missing"),
        ("checkpoint.npz", damage_arrays, r"checkpoint\.npz is damaged"),
        ("checkpoint.npz", lambda p: p.write_bytes(b""), r"checkpoint\.npz is damaged"),
        (
            "checkpoint.npz",
            lambda p: np.savez(p, epoch=3),
            "damaged or of another version: 'seeds'",
        ),
        ("checkpoint.npz", lambda p: change(p, steps=np.zeros(2, int)), r"steps is \[2\]"),
        ("checkpoint.npz", lambda p: change(p, actor=np.zeros((1, 4640))), "actor is .* float64"),
        ("checkpoint.npz", lambda p: change(p, seeds=np.array([5])), r"its seeds are \[5\]"),
        (
            "checkpoint.npz",
            lambda p: change(p, **{"replay.rows": np.zeros((1, 1, 9), np.float32)}),
            "rows is",
        ),
        ("checkpoint.npz", lambda p: p.unlink(), "nothing has been trained there yet"),
    ],
)
def test_damaged_folders(tmp_path, name, damage, message):
    folder = trained(tmp_path / "run", [0], steps=400)
    damage(folder / name)
    with pytest.raises(UserError, match=message):
        load_training(folder)


def test_checkpoint_of_other_nets_is_refused(tmp_path):
    folder = trained(tmp_path / "run", [0], steps=400)
    (folder / "checksums.json").unlink()
    content = json.loads((folder / "config.json").read_text())
    content["hyperparameters"]["hidden"] = [32, 32]
    (folder / "config.json").write_text(json.dumps(content))
    with pytest.raises(UserError, match=r"actor is \[1, 4640\] float32, expected"):
        load_training(folder)


def test_checkpoints_are_not_unpickled(tmp_path):
    folder = trained(tmp_path / "run", [0], steps=400)
    np.savez(folder / "checkpoint.npz", epoch=np.array([{}], dtype=object))
    with pytest.raises(UserError, match="damaged"):
        load_training(folder)
