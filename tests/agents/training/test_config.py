"""Configurations of run folders: algorithms of others, bounds of actions, two writers at once."""

import dataclasses
import json
import subprocess
import sys

import pytest
from toys import register

from agents.errors import UserError
from agents.paper.presets import preset
from agents.training.config import TrainConfig, read_spaces
from agents.training.environments import Spaces
from agents.training.files import read_json

TASK = "Circle2D-1-v0"
register()


def config(task=TASK, seeds=(0,), **changes):
    return TrainConfig("cpo", task, seeds, 100, preset("cpo", TASK), **changes)


def edit(folder, **changes):
    path = folder / "config.json"
    content = json.loads(path.read_text()) | changes
    (folder / "checksums.json").unlink(missing_ok=True)
    path.write_text(json.dumps({k: v for k, v in content.items() if v is not None}))


def test_it_is_read_as_it_was_written(tmp_path):
    # The last: `train` let it through before, and such folders are still read.
    more = {"snapshots": config(evaluate_every=50), "timeout": config(step_timeout=2.0)}
    for name, it in ({"plain": config()} | more).items():
        it.write(tmp_path / name)
        assert TrainConfig.read(tmp_path / name) == it
        assert TrainConfig.read(tmp_path / name, strict=False) == it
    assert read_json(tmp_path / "plain" / "config.json")["algorithm_module"] == (
        "agents.algorithms.cpo"
    )


def test_hyperparameters_newer_than_the_runs(tmp_path):
    """They are as the family was before they came, not as SAC-LB-Streak has them now."""
    TrainConfig("sac-lb-streak", TASK, (0,), 100, preset("sac-lb-streak", TASK)).write(tmp_path)
    values = json.loads((tmp_path / "config.json").read_text())["hyperparameters"]
    for name in ("novelty_bonus", "random_share", "streak_weight", "novelty_length"):
        del values[name]
    edit(tmp_path, hyperparameters=values)
    read = TrainConfig.read(tmp_path).hyperparameters
    off = {"novelty_bonus": 0.0, "random_share": 0.0, "streak_weight": 0.0}
    assert read == dataclasses.replace(preset("sac-lb-streak", TASK), **off)


def test_an_algorithm_that_is_not_registered(tmp_path):
    config().write(tmp_path)
    values = {"cost_limit": 5.0, "hidden": [8, 9], "my_factor": 0.25}
    edit(tmp_path, algorithm="mine", algorithm_module="my_module", hyperparameters=values)
    with pytest.raises(
        UserError, match=r"'mine' of .* is not registered here: import my_module first"
    ):
        TrainConfig.read(tmp_path)
    edit(tmp_path, algorithm_module="__main__")
    with pytest.raises(UserError, match="register it in a module, not in a script"):
        TrainConfig.read(tmp_path)
    read = TrainConfig.read(tmp_path, strict=False)
    assert dataclasses.asdict(read.hyperparameters) == {**values, "hidden": (8, 9)}
    assert read.settings["hyperparameters.my_factor"] == 0.25
    with pytest.raises(dataclasses.FrozenInstanceError):
        read.hyperparameters.my_factor = 1.0
    assert "my_module" not in sys.modules
    edit(tmp_path, algorithm_module=None)  # a folder of before it was recorded
    with pytest.raises(UserError, match="unknown algorithm 'mine': valid are trpo-lag, "):
        TrainConfig.read(tmp_path)


def test_damage_is_named_in_either_way_of_reading(tmp_path):
    config().write(tmp_path)
    edit(tmp_path, seeds=[0, 0])
    for strict in (True, False):
        with pytest.raises(UserError, match="seeds must be different"):
            TrainConfig.read(tmp_path, strict=strict)


def test_bounds_of_actions(tmp_path):
    it = config("Walk-v0")
    it.write(tmp_path)
    expected = Spaces(2, (-2.0,), (2.0,), "float32")
    assert read_spaces(tmp_path, it) == expected
    edit(tmp_path, spaces=None)  # a folder of an earlier version: the task tells them
    assert read_spaces(tmp_path, it) == expected
    unknown = dataclasses.replace(it, task="Nowhere-v0")
    with pytest.raises(UserError, match=r"does not hold the bounds of actions.*Nowhere"):
        read_spaces(tmp_path, unknown)
    for wrong in ({}, {**expected._asdict(), "low": [3.0]}, {**expected._asdict(), "high": [1, 2]}):
        edit(tmp_path, spaces=wrong)
        with pytest.raises(UserError, match=r"config\.json is damaged: spaces"):
            read_spaces(tmp_path, it)


def test_a_task_that_cannot_be_made_leaves_no_folder(tmp_path):
    with pytest.raises(UserError, match="Nowhere"):
        config("Nowhere-v0").write(tmp_path / "x")
    assert not (tmp_path / "x").exists()


WRITER = """
import sys
from pathlib import Path
from agents.errors import UserError
from agents.paper.presets import preset
from agents.training.config import TrainConfig

seeds = tuple(map(int, sys.argv[2:]))
config = TrainConfig("cpo", "Circle2D-1-v0", seeds, 100, preset("cpo", "Circle2D-1-v0"))
print("ready", flush=True)
sys.stdin.readline()
try:
    config.write(Path(sys.argv[1]))
except UserError as error:
    sys.exit(2)
"""


def test_two_that_make_one_folder_at_once(tmp_path):
    """One is refused, and what the other made is whole."""
    for k in range(4):
        folder = tmp_path / str(k)
        seeds = (("0", "1"), ("5", "6"))
        writers = [
            subprocess.Popen(
                [sys.executable, "-c", WRITER, str(folder), *of_one],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
            for of_one in seeds
        ]
        for writer in writers:
            assert writer.stdout.readline() == "ready\n"
        for writer in writers:
            writer.stdin.write("go\n")
            writer.stdin.flush()
        for writer in writers:
            writer.communicate(timeout=60)
        assert sorted(writer.returncode for writer in writers) == [0, 2]
        [made] = [s for s, writer in zip(seeds, writers, strict=True) if not writer.returncode]
        assert TrainConfig.read(folder).seeds == tuple(map(int, made))
        assert {path.name for path in folder.glob("seed-*")} == {f"seed-{s}" for s in made}
