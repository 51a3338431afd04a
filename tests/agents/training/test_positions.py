"""Positions of every step, as the task's view gives them: of any vectorization, also in groups."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.spaces import Box
from toys import Target

from agents.errors import UserError
from agents.paper.presets import preset
from agents.results.steps import play_trained
from agents.training.config import TrainConfig
from agents.training.environments import view_of
from agents.training.loop import Training, load_training, train
from agents.training.step_files import COSTS, VISITED, read_steps
from emcc import EpisodeRecords

POINT = "circle2d_mj/SafetyPointCircle1-v0"


class Drift(gym.Env):
    """A point that drifts from a random start; its place is in the info alone, and its
    observation is the place in tenths, so that both can be compared."""

    observation_space = Box(-np.inf, np.inf, (2,))
    action_space = Box(-1.0, 1.0, (2,))

    class view:  # an attribute of the environment
        extent, axes = (-9.0, 9.0, -9.0, 9.0), ("x", "y")

        @staticmethod
        def positions(observation, info):
            return np.stack([info["px"], 10 * observation[..., 1]], axis=-1)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.place, self.end = self.np_random.normal(size=2), self.np_random.integers(3, 9)
        return (self.place / 10).astype(np.float32), {"px": self.place[0]}

    def step(self, action):
        self.place = self.place + 0.1 * np.asarray(action, float)
        self.end -= 1
        info = {"px": self.place[0], "cost": float(self.place[0] > 0)}
        return (self.place / 10).astype(np.float32), 0.0, False, self.end == 0, info


@pytest.fixture(autouse=True)
def tasks():
    gym.register("Drift-v0", Drift, disable_env_checker=True)
    yield
    del gym.registry["Drift-v0"]


def config(task, vectorization="auto", algorithm="trpo-lag", **changes):
    hyperparameters = replace(preset(algorithm, task), episodes=3, critic_iterations=1)
    it = TrainConfig(algorithm, task, (3, 4), 40, hyperparameters, vectorization=vectorization)
    return replace(it, **changes)


def trained(folder, *args, **kwargs):
    config(*args, **kwargs).write(folder)
    train(folder)
    return folder


@pytest.mark.parametrize("vectorization", ["sync", "async"])
def test_positions_come_from_observation_and_info(tmp_path, vectorization):
    folder = trained(tmp_path / "x", "Drift-v0", vectorization)
    for seed in (3, 4):
        visited, costs = (read_steps(folder / f"seed-{seed}", name) for name in (VISITED, COSTS))
        assert visited.dtype == np.float32
        np.testing.assert_array_equal(costs, visited[:, 0] > 0)  # of the same step
        records = EpisodeRecords.load(folder / f"seed-{seed}" / "episodes.csv")
        assert len(visited) == records.total_steps
        jumps = np.abs(np.diff(visited, axis=0)).max(axis=1)
        within = np.setdiff1d(np.arange(len(jumps)), records.start_step[1:] - 1)
        assert jumps[within].max() < 0.1001 * 1.01  # a step goes that far


def test_drawn_episodes_begin_where_they_started(tmp_path):
    """Though some end and are reset while others go on."""
    folder = trained(tmp_path / "x", "Drift-v0")
    played = play_trained(folder, TrainConfig.read(folder), (3, 4), episodes=5)
    episodes = [episode for of_run in played.values() for episode in of_run]
    assert len({len(episode.costs) for episode in episodes}) > 1
    for positions, costs in episodes:
        assert len(positions) == len(costs) + 1
        assert np.abs(np.diff(positions, axis=0)).max() < 0.1001 * 1.01  # a step goes that far


@pytest.mark.parametrize("task", ["Circle2D-1-v0", "Circle2DMuJoCo-1-v0"])
def test_every_vectorization_gives_the_same(tmp_path, task):
    folders = [trained(tmp_path / how, task, how, steps=150) for how in ("auto", "sync", "async")]
    for seed in (3, 4):
        files = {(folder / f"seed-{seed}" / VISITED).read_bytes() for folder in folders}
        assert len(files) == 1


def test_folders_side_by_side_record_what_each_does_alone(tmp_path):
    """Of two tasks with views of their own, and one with none."""
    gym.register("Blind-v0", type("Blind", (Drift,), {"view": None}), disable_env_checker=True)
    tasks = ("Drift-v0", "Circle2D-3-v0", "Blind-v0")
    alone = [trained(tmp_path / f"alone{k}", task) for k, task in enumerate(tasks)]
    jointly = [tmp_path / f"jointly{k}" for k in range(3)]
    hyperparameters = config("Drift-v0").hyperparameters
    for task, folder in zip(tasks, jointly, strict=True):
        config(task, hyperparameters=hyperparameters).write(folder)
    for folder, task in zip(alone, tasks, strict=True):
        again = config(task, hyperparameters=hyperparameters)
        if again != TrainConfig.read(folder):  # the preset's cost limit is another
            again.write(tmp_path / f"{folder.name} again")
            train(tmp_path / f"{folder.name} again")
    train(*jointly)
    for k, folder in enumerate(jointly):
        again = tmp_path / f"alone{k} again"
        other = again if again.exists() else alone[k]
        files = {path.name for path in (folder / "seed-3").iterdir()}
        assert (VISITED in files) == (k < 2)
        for name in files & {VISITED, COSTS, "episodes.csv"}:
            ours, theirs = ((of / "seed-4" / name).read_bytes() for of in (folder, other))
            assert ours == theirs
    del gym.registry["Blind-v0"]


def test_a_safety_task_records_where_the_point_is(tmp_path):
    """It starts within 0.4 m of the middle, and moves a few centimetres a step."""
    folder = trained(tmp_path / "x", POINT, steps=50, task_parameters={"max_episode_steps": 20})
    visited = read_steps(folder / "seed-3", VISITED)
    assert np.abs(visited[::20]).max() < 1.0
    assert 0 < np.abs(np.diff(visited[:20], axis=0)).max() < 0.1


def test_views(tmp_path):
    assert view_of("Circle2D-1-v0", {}).axes[0].startswith("x")
    assert view_of("circle2d_mj:Circle2D-1-v0", {"constraint_radius": 3.0}).extent[1] > 3
    assert view_of(POINT, {}).axes == ("x (m)", "y (m)")
    assert view_of("Drift-v0", {}) is Drift.view
    gym.register("Target-v7", Target)
    assert view_of("Target-v7", {}) is None
    del gym.registry["Target-v7"]
    assert view_of("no_such_module:Nowhere-v0", {}) is None


def test_a_task_without_a_view_records_costs_alone(tmp_path):
    gym.register("Circle2DTarget-v9", Target)  # which is not Circle2D
    it = config("Circle2DTarget-v9", steps=10)
    assert it.hyperparameters.cost_limit == 25
    it.write(tmp_path)
    Training(it).save(tmp_path)
    found = {path.name for path in (tmp_path / "seed-3").iterdir()}
    assert COSTS in found
    assert VISITED not in found
    del gym.registry["Circle2DTarget-v9"]


def test_a_folder_from_before_its_task_had_a_view_goes_on_without(tmp_path):
    """As the Safety tasks were trained by earlier versions."""
    it = config("Drift-v0", steps=80)
    it.write(tmp_path)
    training = Training(it)
    training.run_epoch()
    training.save(tmp_path)
    for seed in (3, 4):
        (tmp_path / f"seed-{seed}" / VISITED).unlink()
    train(tmp_path)
    assert load_training(tmp_path).done
    assert not (tmp_path / "seed-3" / VISITED).exists()


def test_views_that_do_not_fit(tmp_path, monkeypatch):
    monkeypatch.setattr(Drift.view, "positions", lambda observation, info: observation[..., :1])
    with pytest.raises(UserError, match=r"must give positions \[6, 2\], got \[6, 1\]"):
        trained(tmp_path / "x", "Drift-v0")
    monkeypatch.setattr(Drift.view, "positions", lambda observation, info: info["height"])
    with pytest.raises(UserError, match=r"the view of .* needs info\['height'\]"):
        trained(tmp_path / "y", "Drift-v0")
