"""Grids split over the available cores, simulated with made-up durations."""

import threading
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.algorithms import algorithm
from agents.errors import UserError
from agents.paper.grid import PAPER_ALGORITHMS, circle2d_tasks
from agents.training import grid
from agents.training.config import TrainConfig
from agents.training.launcher import Launcher

TASKS = tuple(circle2d_tasks(range(4), mujoco=False))


def training(name="cpo", tasks=TASKS, seeds=(0, 1, 2), steps=1000):
    return TrainConfig(name, tuple(tasks), tuple(seeds), steps, algorithm(name).config())


def cells(config):
    return [(config.algorithm, task, seed) for task in config.tasks for seed in config.seeds]


def duration(config):
    """Return a made-up duration: running side by side costs as much as two further runs."""
    share = algorithm(config.algorithm).work * config.steps
    return share * (len(config.runs) + 2)


def simulated(configs, workers):
    """Return the start and end of each training of a queue, each taken by the next free worker."""
    free, times = [0.0] * workers, []
    for config in configs:
        worker = min(range(workers), key=free.__getitem__)
        times.append((free[worker], free[worker] + duration(config)))
        free[worker] = times[-1][1]
    return times


def paper(out):
    """Return the paper's grid of sixty runs: five algorithms, four tasks, three seeds."""
    return grid.grid(out, TASKS, PAPER_ALGORITHMS, range(3), steps=1000)


def test_sixty_runs_on_sixteen_cores_are_sixteen_processes(tmp_path):
    whole = paper(tmp_path)
    assert len(whole) == 5
    parts = grid.split(whole, 16)
    assert len(parts) == 16
    every = sorted(cell for config in parts.values() for cell in cells(config))
    assert every == sorted(cell for config in whole.values() for cell in cells(config))
    assert len(set(every)) == 60
    times = simulated(parts.values(), 16)
    assert {start for start, _ in times} == {0.0}  # no run waits for a core
    before = max(map(duration, whole.values()))
    assert max(end for _, end in times) < 0.4 * before


def test_one_core_trains_whole_trainings(tmp_path):
    whole = paper(tmp_path)
    parts = grid.split(whole, 1)
    assert parts.keys() == whole.keys() and all(parts[f].runs == whole[f].runs for f in whole)


@given(
    st.lists(
        st.tuples(st.integers(1, 4), st.integers(1, 7), st.integers(1, 9)), min_size=1, max_size=6
    ),
    st.integers(1, 20),
)
def test_parts_hold_every_run_once_and_take_no_longer(shapes, workers):
    folders = {
        Path("nowhere", str(k)): training("cpo", TASKS[:tasks], range(seeds), 100 * steps)
        for k, (tasks, seeds, steps) in enumerate(shapes)
    }
    parts = grid.split(folders, workers)
    for folder, config in folders.items():
        own = [c for f, c in parts.items() if f == folder or f.parent == folder]
        assert sorted(x for c in own for x in cells(c)) == sorted(cells(config))
    whole = sorted(folders.values(), key=duration, reverse=True)
    cut = sorted(parts.values(), key=duration, reverse=True)
    before, after = (max(end for _, end in simulated(c, workers)) for c in (whole, cut))
    assert after <= before * (1 + 1e-9)
    works = [grid.work(config) for config in parts.values()]
    assert works == sorted(works, reverse=True)


def test_a_grid_that_has_begun_stays_split_as_it_is(tmp_path):
    """On a machine with another number of cores the same command finds its folders."""
    whole = paper(tmp_path)
    parts = grid.split(whole, 16)
    grid.prepare(parts)
    for workers in (1, 5, 60):
        assert grid.split(whole, workers).keys() == parts.keys()
    other = {folder: training("cpo") for folder in (tmp_path / "a", tmp_path / "b")}
    grid.prepare(other)
    assert grid.split(other, 16).keys() == other.keys()


def test_other_seeds_are_not_trained_beside_the_parts_of_a_training(tmp_path):
    """Whatever the number of parts: a report of the folder would count common seeds twice."""
    for seeds in (2, 3, 5, 6, 8):
        out = tmp_path / str(seeds)
        grid.prepare(grid.split({out: training(tasks=TASKS[:1], seeds=range(4))}, 4))
        made = sorted(path.name for path in out.iterdir())
        assert made == ["1-of-4", "2-of-4", "3-of-4", "4-of-4"]
        with pytest.raises(UserError, match=r"other (settings|tasks or seeds).* for out"):
            grid.prepare(grid.split({out: training(tasks=TASKS[:1], seeds=range(seeds))}, 4))
        assert sorted(path.name for path in out.iterdir()) == made


def test_nothing_is_made_where_one_training_cannot_be(tmp_path):
    """Two input scales fit the observations of Circle2D, but not of Circle2DMuJoCo. With a valid
    configuration both folders are made."""
    scaled = algorithm("cpo").config(input_scale=(10.0, 5.0))
    tasks = ("Circle2D-1-v0", "Circle2DMuJoCo-1-v0")
    both = {tmp_path / task: TrainConfig("cpo", (task,), (0,), 100, scaled) for task in tasks}
    with pytest.raises(UserError, match="input_scale must be one number, or 4"):
        grid.prepare(both)
    assert [*tmp_path.iterdir()] == []
    grid.prepare(
        {
            f: replace(config, hyperparameters=algorithm("cpo").config())
            for f, config in both.items()
        }
    )
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(tasks)


@pytest.mark.parametrize("workers", [1, 3, 8])
def test_no_worker_is_idle_while_a_training_waits(workers):
    """The trainings here end when the test says so. They start in the order of the queue, and at
    any time as many run as there are workers."""
    changed, started, ended = threading.Condition(), [], set()

    def train(folder, ending):
        with changed:
            started.append(folder.name)
            changed.notify_all()
            assert changed.wait_for(lambda: folder.name in ended, timeout=60)
        return ""

    names = [str(k) for k in range(12)]
    with Launcher(workers, train) as trainings:
        for name in names:
            trainings.submit(Path(name))
        for over in range(len(names)):
            with changed:
                most = min(workers + over, len(names))
                assert changed.wait_for(lambda most=most: len(started) == most, timeout=60)
                assert sorted(started, key=int) == names[:most]
                running = [name for name in started if name not in ended]
                ended.add(running[over % len(running)])
                changed.notify_all()
        trainings.wait(every=0.1)
        assert not trainings.failed
