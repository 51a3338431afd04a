"""Which folders of a grid train together, so that all workers end at about the same time."""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Box
from small_runs import write_status
from toys import Walk

from agents.paper import grid
from agents.paper.presets import PAPER_ALGORITHMS


def groups(workers, algorithms=("sac-lag", "trpo-lag"), levels=(0, 1, 2, 3), seeds=grid.SEEDS):
    tasks = grid.circle2d_tasks(levels, mujoco=False)
    with TemporaryDirectory() as out:
        configs = grid.grid(Path(out), tasks, algorithms, seeds)
        grid.prepare(configs)
        found = grid.groups(configs, workers)
    assert sorted(folder for group in found for folder in group) == sorted(configs)
    assert all(len({folder.name for folder in group}) == 1 for group in found)
    return [(group[0].name, len(group)) for group in found]


def test_groups_keep_the_workers_busy():
    """Times in steps of TRPO-Lag, x 1e6, where n folders of 3 runs take (3 n + 2) each: SAC-Lag 70
    as one group, 40 as two, 25 as four; TRPO-Lag 14, 8, 5."""
    assert groups(1) == [("sac-lag", 4), ("trpo-lag", 4)]  # 84, or 96, or 120
    assert groups(2) == [("sac-lag", 2)] * 2 + [("trpo-lag", 2)] * 2  # 70, or 48, or 60
    assert groups(3) == [("sac-lag", 2)] * 2 + [("trpo-lag", 4)]  # 70, or 40, or 50
    assert groups(5) == [("sac-lag", 1)] * 4 + [("trpo-lag", 4)]  # 70, or 40, or 25
    assert groups(64) == [("sac-lag", 1)] * 4 + [("trpo-lag", 4)]


def test_an_algorithm_is_split_alone_where_that_fills_a_gap():
    """In one group SAC-Lag and SAC-LB take 70 each, WCSAC 72.8, CPO 18.2, TRPO-Lag 14: the last of
    two workers ends after 140. With WCSAC in two groups of 41.6 it does after 70 + 41.6 + 18.2."""
    alone = [("cpo", 4), ("trpo-lag", 4)]
    halves = [("wcsac", 2)] * 2
    assert groups(2, PAPER_ALGORITHMS) == [("sac-lag", 4), ("sac-lb", 4), *halves, *alone]


def test_groups_have_twelve_runs_at_most():
    assert groups(1, ["cpo"], seeds=range(6)) == [("cpo", 2)] * 2
    assert groups(1, ["cpo"], seeds=range(5)) == [("cpo", 2)] * 2
    assert groups(1, ["cpo"], (0, 1, 2), range(5)) == [("cpo", 1), ("cpo", 2)][::-1]
    assert groups(1, ["cpo"], seeds=range(13)) == [("cpo", 1)] * 4
    assert grid.groups({}, 2) == []


def test_groups_are_of_equal_settings_sizes_and_progress(tmp_path):
    tasks = ["Circle2D-0-v0", "Circle2D-1-v0", "Circle2DMuJoCo-1-v0"]
    configs = grid.grid(tmp_path, tasks, ["cpo"], (0,), 100)
    (flat, second, physics) = configs
    grid.prepare(configs)
    assert grid.groups(configs, 1) == [(flat, second), (physics,)]  # observations of 2 and of 4
    write_status(flat, 0.4)
    assert len(grid.groups(configs, 1)) == 3
    (flat / "status.json").unlink()
    configs[second] = replace(configs[second], checkpoint_every=7)
    assert len(grid.groups(configs, 1)) == 3


def test_a_task_of_two_sizes_makes_two_groups(tmp_path):
    """By its parameters; nobody asks the task again once the folders are there."""

    class Sized(Walk):
        def __init__(self, size):
            super().__init__()
            self.observation_space = Box(-np.inf, np.inf, (size,))

    gym.register("Sized-v0", Sized, disable_env_checker=True)
    try:
        [one] = grid.grid(tmp_path, ["Sized-v0"], ["cpo"], (0,), 100).values()
        configs = {
            tmp_path / name: replace(one, task_parameters={"size": size})
            for name, size in (("a", 2), ("b", 3), ("c", 2))
        }
        grid.prepare(configs)
    finally:
        del gym.registry["Sized-v0"]
    a, b, c = configs
    assert sorted(grid.groups(configs, 1)) == [(a, c), (b,)]
