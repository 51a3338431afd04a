"""Folders that train together: each is left as if it had trained alone."""

import signal
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from small_runs import results
from toys import register

from agents.algorithms import algorithm
from agents.cli.main import main
from agents.errors import UserError
from agents.paper.presets import preset
from agents.training.config import TrainConfig
from agents.training.files import read_arrays
from agents.training.loop import load_training, train
from agents.training.status import sessions

register()
SEEDS = {0: (3, 4), 1: (4,), 3: (5, 3)}
"""Of the folder of each level; seeds 3 and 4 are in two folders."""


def config(name, level, **changes):
    task = f"Circle2D-{level}-v0"
    hyperparameters = preset(name, task)
    if name == "sac-lag":
        hyperparameters = replace(hyperparameters, random_steps=100, gradient_steps=2)
    else:
        hyperparameters = replace(hyperparameters, episodes=3, critic_iterations=2)
    it = TrainConfig(name, task, SEEDS[level], 900, hyperparameters, checkpoint_every=300)
    return replace(it, **changes)


def made(path, *configs):
    """A folder for each."""
    folders = [path / f"{k}-{it.task}" for k, it in enumerate(configs)]
    for folder, it in zip(folders, configs, strict=True):
        it.write(folder)
    return folders


def trained_alone(path, *configs):
    folders = made(path, *configs)
    for folder in folders:
        train(folder)
    return folders


def assert_same(folders, expected):
    for folder, other in zip(folders, expected, strict=True):
        ours, theirs = results(folder), results(other)
        assert ours.keys() == theirs.keys()
        for name, data in ours.items():
            assert data == theirs[name], f"{folder}: {name}"


@pytest.fixture(scope="module", params=["sac-lag", "trpo-lag"])
def alone(request, tmp_path_factory):
    """The algorithm, and folders of levels 0, 1 and 3 that trained alone."""
    configs = [config(request.param, level) for level in (0, 1, 3)]
    return request.param, trained_alone(tmp_path_factory.mktemp("alone"), *configs)


def test_folders_together_are_as_alone(alone, tmp_path):
    name, expected = alone
    folders = made(tmp_path, *(config(name, level) for level in (0, 1, 3)))
    assert [training.config.seeds for training in train(*folders)] == [(3, 4), (4,), (5, 3)]
    assert_same(folders, expected)
    assert results(folders[0])["seed-4/visited.npy"] != results(folders[1])["seed-4/visited.npy"]


KILLED = """
import os, signal, sys
from pathlib import Path
from agents.training.loop import Training, train

left, save = int(sys.argv[1]), Training.save
def save_some(training, folder):
    global left
    if not left:
        os.kill(os.getpid(), signal.SIGKILL)
    left -= 1
    save(training, folder)

Training.save = save_some
train(*map(Path, sys.argv[2:]))
"""


def test_killed_between_two_checkpoints_and_resumed_in_another_grouping(alone, tmp_path):
    """Folders of the next group stand at epochs of their own."""
    name, expected = alone
    folders = a, b, c = made(tmp_path, *(config(name, level) for level in (0, 1, 3)))
    for saves, group in ((4, folders), (1, [c, b])):
        command = [sys.executable, "-c", KILLED, str(saves), *map(str, group)]
        assert subprocess.run(command, check=False).returncode == -signal.SIGKILL
    epochs = [int(read_arrays(folder / "checkpoint.npz")["epoch"]) for folder in folders]
    assert len(set(epochs)) > 1
    seen = []
    train(c, a, on_epoch=lambda trainings: seen.append([of.epoch for of in trainings]))
    assert min(seen[0]) >= min(epochs[0], epochs[2]) > 1  # from the checkpoints, not the start
    train(b)
    assert_same(folders, expected)


@pytest.mark.parametrize("name", ["sac-lb", "cpo"])
def test_folders_that_fail_and_end_at_different_times(name, tmp_path, capsys):
    """Episodes end early, on their own; luck as in `Walk` poisons runs of one folder."""
    hyperparameters = algorithm(name).config(cost_limit=1.0, batch_size=32, hidden=(32, 32))
    it = TrainConfig(name, "Walk-v0", (0, 1, 2, 3), 400, hyperparameters, checkpoint_every=100)
    configs = [it, replace(it, seeds=(0, 7), task_parameters={"poison": 0.003})]
    expected = trained_alone(tmp_path / "alone", *configs)
    folders = made(tmp_path / "together", *configs)
    healthy, poisoned = train(*folders)
    assert not healthy.failed.any()
    assert poisoned.failed.any()
    assert healthy.epoch != poisoned.epoch
    assert main(["resume", *map(str, folders)]) == 1
    err = capsys.readouterr().err
    assert f"circle2d: {folders[1]}: seed " in err
    assert f"circle2d: {folders[0]}: seed " not in err
    assert_same(folders, expected)
    assert len(np.unique(load_training(folders[0]).steps)) > 1


def test_the_command_resumes_several(alone, tmp_path, capsys):
    name, expected = alone
    folders = made(tmp_path, config(name, 0), config(name, 1))
    assert main(["resume", *map(str, folders), str(folders[0])]) == 0
    assert_same(folders, expected[:2])
    out, err = capsys.readouterr()
    assert "Circle2D-0" in out
    assert "Circle2D-1" in out
    line = f"{name} Circle2D-0-v0 Circle2D-1-v0 x 3: 100 % after"
    assert line in err
    first, second = map(sessions, folders)
    assert first == second  # of one process
    assert sum(first.values()) > 0


@pytest.mark.parametrize(
    ("other", "message"),
    [
        (config("trpo-lag", 1), "algorithm is sac-lag in .*0-Circle2D-0-v0, trpo-lag in .*1-Circ"),
        (config("sac-lag", 1, steps=800), "steps is 900 in .*, 800 in"),
        (config("sac-lag", 1, checkpoint_every=9), "checkpoint_every is 300 in .*, 9 in"),
        (
            config("sac-lag", 1, hyperparameters=preset("sac-lag", "Circle2D-1-v0")),
            r"hyperparameters\.gradient_steps is 2 in .*, 5 in",
        ),
        (config("sac-lag", 1, task="Walk-v0"), "action size is 2 in .*, 1 in"),
    ],
)
def test_folders_that_cannot_train_together(other, message, tmp_path, capsys):
    folders = made(tmp_path, config("sac-lag", 0), other)
    with pytest.raises(UserError, match=message):
        train(*folders)
    assert main(["resume", *map(str, folders)]) == 2
    err = capsys.readouterr().err
    assert err.startswith("circle2d: folders that train together must have equal settings: ")
    assert err.count("\n") == 1
    assert main(["resume"]) == 2
    assert "folder" in capsys.readouterr().err


def test_one_damaged_checkpoint_stops_the_group(tmp_path):
    folders = made(tmp_path, config("trpo-lag", 0), config("trpo-lag", 1))
    (folders[1] / "checkpoint.npz").write_bytes(b"no checkpoint")
    with pytest.raises(UserError, match=r"1-Circle2D-1-v0/checkpoint\.npz is damaged"):
        train(*folders)
