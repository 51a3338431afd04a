"""The grid of experiments as data: which runs, how long they are, and the time that is left."""

from pathlib import Path

import pytest

from agents.errors import UserError
from agents.paper import grid
from agents.paper.presets import preset


def test_the_papers_grid():
    tasks = grid.circle2d_tasks((0, 1, 2, 3), mujoco=False)
    algorithms = ["trpo-lag", "cpo", "sac-lag", "sac-lb", "wcsac"]
    configs = grid.grid(Path("x"), tasks, algorithms, grid.SEEDS)
    assert sum(len(config.seeds) for config in configs.values()) == 60
    assert {(c.task, c.algorithm) for c in configs.values()} == {
        (task, name) for task in tasks for name in algorithms
    }
    for config in configs.values():
        assert config.hyperparameters == preset(config.algorithm, config.task)
        assert config.steps == 1_000_000
    assert [config.algorithm for config in configs.values()][-4:] == ["trpo-lag"] * 4


def test_lengths_are_the_papers():
    tasks = ["Circle2D-1-v0", "Circle2DMuJoCo-1-v0", "circle2d_mj/SafetyPointGoal1-v0"]
    configs = grid.grid(Path("x"), tasks, ["cpo"], (0,))
    assert [config.steps for config in configs.values()] == [10**6, 10**6, 10**7]


def test_unknown_levels():
    with pytest.raises(UserError, match="levels"):
        grid.circle2d_tasks((), mujoco=True)
    assert grid.circle2d_tasks((1, 0, 1), mujoco=True) == [
        "Circle2DMuJoCo-1-v0",
        "Circle2DMuJoCo-0-v0",
    ]


def test_the_time_left_is_that_of_the_mean_pace_so_far():
    """From 50 to 60 of 100 in 10 s: a second each, and 40 are left."""
    assert grid.seconds_left(10.0, before=50.0, done=60.0, total=100.0) == pytest.approx(40.0)
    assert grid.seconds_left(10.0, before=0.0, done=80.0, total=100.0) == pytest.approx(2.5)
    assert grid.seconds_left(10.0, before=50.0, done=50.0, total=100.0) is None
    assert grid.seconds_left(10.0, before=0.0, done=100.0, total=100.0) == 0.0


def test_shards_are_a_partition(tmp_path):
    tasks = grid.circle2d_tasks((0, 1), mujoco=False)
    whole = grid.grid(tmp_path, tasks, ["cpo", "sac-lb", "trpo-lag"], (0,), 1000)
    parts = [grid.shard(whole, part, 4) for part in (1, 2, 3, 4)]
    assert sorted(folder for part in parts for folder in part) == sorted(whole)
    assert [len(part) for part in parts] == [2, 2, 1, 1]
    assert {next(iter(part.values())).algorithm for part in parts[:2]} == {"sac-lb"}
