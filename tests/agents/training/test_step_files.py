"""Where training was: checked against the costs that the region puts on those places."""

import shutil
from itertools import groupby

import numpy as np
import pytest

from agents.errors import UserError
from agents.lockstep.rollout import Rollout
from agents.paper.presets import preset
from agents.training.config import TrainConfig
from agents.training.loop import load_training, train
from agents.training.step_files import COSTS, VISITED, StepFiles, read_steps
from circle2d_mj import Circle2DConfig
from emcc import EpisodeRecords

TASK = "Circle2D-1-v0"


def trained(folder, algorithm="trpo-lag", task=TASK, steps=1200, **parameters):
    hyperparameters = preset(algorithm, task)
    config = TrainConfig(
        algorithm, task, (3, 4), steps, hyperparameters, parameters, checkpoint_every=500
    )
    config.write(folder)
    train(folder)
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return trained(tmp_path_factory.mktemp("runs") / "x")


@pytest.mark.parametrize("parameters", [{}, {"reset_on_cost": True, "constraint_radius": 3.0}])
def test_rows_are_the_steps_of_the_episodes(tmp_path, parameters):
    """The region's verdict on each row gives every episode's cost and its longest streak."""
    out = trained(tmp_path / "x", **parameters)
    region = Circle2DConfig(level=1, **parameters).region
    for seed in (3, 4):
        records = EpisodeRecords.load(out / f"seed-{seed}" / "episodes.csv")
        visited, costs = (read_steps(out / f"seed-{seed}", name) for name in (VISITED, COSTS))
        assert visited.shape == (records.total_steps, 2)
        assert (visited.dtype, costs.dtype) == (np.float32, np.float64)
        inside = region.contains(visited)
        assert inside.any()
        np.testing.assert_array_equal(costs, inside)
        for start, length, cost, streak in zip(
            records.start_step, records.length, records.cost, records.longest_streak, strict=True
        ):
            steps = inside[start : start + length].tolist()
            assert sum(steps) == cost
            assert max((len(list(g)) for k, g in groupby(steps) if k), default=0) == streak


def test_the_mode_with_physics(tmp_path):
    out = trained(tmp_path / "x", task="Circle2DMuJoCo-1-v0", steps=400)
    records = EpisodeRecords.load(out / "seed-3" / "episodes.csv")
    inside = Circle2DConfig(level=1).region.contains(read_steps(out / "seed-3", VISITED))
    assert inside.sum() == records.cost.sum() > 0
    np.testing.assert_array_equal(read_steps(out / "seed-3", COSTS), inside)


def test_rows_by_hand(tmp_path):
    """Two runs of two episodes each; one run takes no part in the second epoch."""
    rollout = Rollout(*[None] * 9)._replace(
        cost=np.arange(12, dtype=np.float64).reshape(3, 4),
        length=np.array([3, 1, 2, 3]),
    )
    positions = np.arange(24, dtype=np.float32).reshape(3, 4, 2)
    visited = StepFiles(True, 2)
    visited.add(rollout, np.array([True, True]), positions)
    visited.add(rollout, np.array([False, True]), positions)
    folders = [tmp_path / "a", tmp_path / "b"]
    for path in folders:
        path.mkdir()
    visited.write(folders)
    visited.add(rollout, np.array([True, False]), positions)
    visited.write(folders)
    expected = [
        # step 0 of episode 0 is (0, 1), step 1 is (8, 9), step 2 is (16, 17); episode 1: (2, 3)
        np.array([[0, 1], [8, 9], [16, 17], [2, 3]] * 2),
        np.array([[4, 5], [12, 13], [6, 7], [14, 15], [22, 23]] * 2),
    ]
    for path, rows in zip(folders, expected, strict=True):
        np.testing.assert_array_equal(read_steps(path, VISITED), rows)
        np.testing.assert_array_equal(read_steps(path, COSTS), rows[:, 0] / 2)


@pytest.mark.parametrize("name", [VISITED, COSTS])
def test_what_a_killed_process_left_is_overwritten(folder, tmp_path, name):
    copy = tmp_path / "x"
    shutil.copytree(folder, copy)
    path = copy / "seed-3" / name
    expected = path.read_bytes()
    with path.open("ab") as file:
        file.write(b"\x01" * 4000)
    training = load_training(copy)
    training.step_files.write([copy / "seed-3", copy / "seed-4"])
    assert path.read_bytes() == expected


@pytest.mark.parametrize("name", [VISITED, COSTS])
@pytest.mark.parametrize("damage", [lambda p: p.unlink(), lambda p: p.write_bytes(b"\x93NUMPY")])
def test_damaged_records_are_named(folder, tmp_path, damage, name):
    copy = tmp_path / "x"
    shutil.copytree(folder, copy)
    damage(copy / "seed-4" / name)
    with pytest.raises(UserError, match=f"seed-4/{name} is missing or damaged"):
        load_training(copy)
    with pytest.raises(UserError, match=f"{name} is"):
        read_steps(copy / "seed-4", name)
