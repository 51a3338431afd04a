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
    assert sum(len(config.runs) for config in configs.values()) == 60
    assert {(task, c.algorithm) for c in configs.values() for task in c.tasks} == {
        (task, name) for task in tasks for name in algorithms
    }
    for config in configs.values():
        assert config.hyperparameters == preset(config.algorithm, config.tasks[0])
        assert config.steps == 1_000_000
    # Four tasks of three runs are one training; what takes longest goes first.
    assert [folder.name for folder in configs][-1] == "trpo-lag"
    assert len(configs) == 5


def test_tasks_train_together_where_they_are_alike_and_few():
    tasks = grid.circle2d_tasks((0, 1), mujoco=False)
    assert list(grid.grid(Path("x"), tasks, ["cpo"], range(6))) == [Path("x/cpo")]
    apart = [Path("x") / task / "cpo" for task in tasks]
    assert list(grid.grid(Path("x"), tasks, ["cpo"], range(7))) == apart
    safety = "circle2d_mj/SafetyPointGoal1-v0"  # of another preset
    other = grid.grid(Path("x"), [tasks[0], safety], ["cpo"], (0,), 1000)
    assert set(other) == {apart[0], Path("x/circle2d_mj-SafetyPointGoal1-v0/cpo")}


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


def test_shards_are_a_partition(tmp_path):
    tasks = grid.circle2d_tasks((0, 1), mujoco=False)
    whole = grid.grid(tmp_path, tasks, ["cpo", "sac-lb", "trpo-lag"], range(7), 1000)
    parts = [grid.shard(whole, part, 4) for part in (1, 2, 3, 4)]
    assert sorted(folder for part in parts for folder in part) == sorted(whole)
    assert [len(part) for part in parts] == [2, 2, 1, 1]
    assert {next(iter(part.values())).algorithm for part in parts[:2]} == {"sac-lb"}


def test_the_benchmark():
    """Nine tasks; ten seeds on Circle2D, five off-policy, three elsewhere."""
    configs = grid.benchmark(Path("x"), grid.BENCHMARK, ["cpo", "cal"])
    counts = {(c.tasks[0], c.algorithm): (len(c.seeds), c.steps) for c in configs.values()}
    assert len(counts) == 18
    for (task, name), found in counts.items():
        few = 10 if name == "cpo" else 5
        assert found == (few if task.startswith("Circle2D") else 3, 1_000_000)
    quick = grid.benchmark(Path("x"), grid.BENCHMARK, ["cpo"], quick=True)
    assert {(len(c.seeds), c.steps) for c in quick.values()} == {(2, 10_000), (2, 30_000)}
