"""The grid of experiments as data: which trainings, how long they are, in which order."""

from dataclasses import replace
from itertools import product
from pathlib import Path

import pytest
from small_trainings import trainer

from agents.errors import UserError
from agents.paper import grid
from agents.paper.presets import PAPER_ALGORITHMS, preset

CIRCLE2D = grid.circle2d_tasks((0, 1, 2, 3), mujoco=False)


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


@pytest.mark.parametrize("seeds", [(0, 1, 2), range(5)])
def test_the_papers_grid(seeds):
    """Every run once, with the preset of its task; together where there are twelve at most."""
    configs = grid.grid(Path("x"), CIRCLE2D, PAPER_ALGORITHMS, seeds)
    assert sorted(runs_of(configs)) == sorted(product(PAPER_ALGORITHMS, CIRCLE2D, seeds))
    together = 4 * len(seeds) <= 12
    for folder, it in configs.items():
        assert all(it.hyperparameters == preset(it.algorithm, task) for task in it.tasks)
        assert it.steps == 1_000_000
        assert len(it.tasks) == (4 if together else 1)
        assert folder.name == it.algorithm
        assert len(folder.parts) == (2 if together else 3)
    last = [it.algorithm for it in configs.values()][-len(configs) // 5 :]
    assert set(last) == {"trpo-lag"}  # which takes least


def test_tasks_of_other_lengths_or_presets_train_apart():
    tasks = ["Circle2D-1-v0", "Circle2DMuJoCo-1-v0", "circle2d_mj/SafetyPointGoal1-v0"]
    configs = grid.grid(Path("x"), [*tasks, tasks[0]], ["cpo"], (0,))
    steps = {task: it.steps for it in configs.values() for task in it.tasks}
    assert steps == dict(zip(tasks, (10**6, 10**6, 10**7), strict=True))
    assert Path("x/circle2d_mj-SafetyPointGoal1-v0/cpo") in configs
    safety = preset("cpo", tasks[2])
    assert configs[Path("x/circle2d_mj-SafetyPointGoal1-v0/cpo")].hyperparameters == safety


def test_tasks_of_other_observations_can_be_made(tmp_path):
    """Circle2D has 2 numbers, with physics 4."""
    configs = grid.grid(tmp_path, ["Circle2D-1-v0", "Circle2DMuJoCo-1-v0"], ["cpo"], (0,), 100)
    grid.prepare(configs)
    assert sorted(runs_of(configs)) == [
        ("cpo", "Circle2D-1-v0", 0),
        ("cpo", "Circle2DMuJoCo-1-v0", 0),
    ]


def test_shards_are_a_partition(tmp_path):
    tasks = grid.circle2d_tasks((0, 1), mujoco=False)
    whole = grid.grid(tmp_path, tasks, ["cpo", "sac-lb", "trpo-lag"], range(7), 1000)
    parts = [grid.shard(whole, part, 4) for part in (1, 2, 3, 4)]
    assert sorted(folder for part in parts for folder in part) == sorted(whole)
    assert [len(part) for part in parts] == [2, 2, 1, 1]
    assert {next(iter(part.values())).algorithm for part in parts[:2]} == {"sac-lb"}


def test_work_is_that_of_all_runs():
    """In steps of a run of TRPO-Lag: 5 of SAC-Lag's for each."""
    it = grid.grid(Path("x"), CIRCLE2D, ["sac-lag"], (0, 1, 2), 1000)[Path("x/sac-lag")]
    assert grid.work(it) == pytest.approx(5 * 4 * 3 * 1000)
    assert grid.work(replace(it, seeds=(0,))) == pytest.approx(5 * 4 * 1000)


def test_folders_are_made_once_and_keep_their_settings(tmp_path):
    configs = grid.grid(tmp_path, ["Circle2D-1-v0"], ["cpo", "trpo-lag"], (0,), 100)
    first, second = configs
    grid.prepare({first: configs[first]})
    written = (first / "config.json").read_bytes()
    with pytest.raises(UserError, match=r"steps 100 \(now 200\)"):
        grid.prepare({second: configs[second], first: replace(configs[first], steps=200)})
    assert not second.exists()  # checked before anything is made
    grid.prepare(configs)
    assert (first / "config.json").read_bytes() == written
    assert trainer(configs[second], second).config == configs[second]
    assert not any(map(grid.finished, configs))
