"""The recorded positions and costs of every step, and what results keep of them."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.spaces import Box
from small_runs import TRPO, steps_of

import agents
from agents.errors import UserError
from agents.results.reading import read_groups
from agents.training.derive import pack_costs, replay_rows, shown_states
from agents.training.environments import view_of
from emcc import EpisodeRecords
from emcc.records import unpack_costs

OPTIONS = TRPO | {"seeds": (3, 4), "steps": 60, "episodes": 3}


class Drift(gym.Env):
    """A point that drifts from a random start. The view takes x from the info and y from the
    observation, which is a tenth of the place."""

    observation_space = Box(-np.inf, np.inf, (2,))
    action_space = Box(-1.0, 1.0, (2,))

    class view:  # an attribute of the environment
        extent, axes = (-9.0, 9.0, -9.0, 9.0), ("x", "y")

        @staticmethod
        def positions(observation, info):
            return np.stack([info["px"], 10 * observation[..., 1]], axis=-1)

        @staticmethod
        def places(positions):
            return ["left" if x < 0 else "right" for x in positions[:, 0]]

        @staticmethod
        def ways(positions, costs):
            return ["free" if cost == 0 else "" for cost in costs]

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.place, self.end = self.np_random.normal(size=2), self.np_random.integers(3, 9)
        return (self.place / 10).astype(np.float32), {"px": self.place[0]}

    def step(self, action):
        self.place = self.place + 0.1 * np.asarray(action, float)
        self.end -= 1
        info = {"px": self.place[0], "cost": float(self.place[0] > 0)}
        return (self.place / 10).astype(np.float32), 0.0, False, self.end == 0, info


@pytest.fixture(autouse=True, scope="module")
def tasks():
    gym.register("Drift-v0", Drift, disable_env_checker=True)
    gym.register("Blind-v0", type("Blind", (Drift,), {"view": None}), disable_env_checker=True)
    yield
    del gym.registry["Drift-v0"], gym.registry["Blind-v0"]


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    out = tmp_path_factory.mktemp("drift") / "x"
    return agents.train("trpo-lag", ("Drift-v0", "Blind-v0"), out=out, **OPTIONS)


def test_positions_come_from_observation_and_info(runs):
    """Though episodes end at different times, and beside a task without a view."""
    for seed in (3, 4):
        names = ("positions", "costs/cost", "length")
        positions, costs, length = (steps_of(runs.folder, f"Drift-v0/{seed}", n) for n in names)
        assert positions.dtype == np.float32
        assert len(positions) == length.sum()
        assert len(set(length.tolist())) > 1
        np.testing.assert_array_equal(costs, positions[:, 0] > 0)  # of the same step
        jumps = np.abs(np.diff(positions, axis=0)).max(axis=1)
        within = np.setdiff1d(np.arange(len(jumps)), np.cumsum(length) - 1)
        assert jumps[within].max() < 0.1001 * 1.01  # a step moves by at most a tenth
        with pytest.raises(KeyError):
            steps_of(runs.folder, f"Blind-v0/{seed}", "positions")


def test_drawn_episodes_have_the_positions_of_every_step(runs):
    group = next(group for group in read_groups([runs.folder], []) if group.task == "Drift-v0")
    for run in group.runs:
        episodes = run.trained()
        assert len(episodes) == 3
        for positions, unsafe in episodes:
            assert np.abs(np.diff(positions, axis=0)).max() < 0.1001 * 1.01
            assert not unsafe[0]
            np.testing.assert_array_equal(unsafe[1:], positions[1:, 0] > 0)
    other = next(group for group in read_groups([runs.folder], []) if group.task == "Blind-v0")
    assert other.runs[0].trained() is None
    for run in group.runs:
        assert sum(run.ends.values()) == 3
        for place, ways in run.ways.items():
            assert set(ways) == {"free"}
            assert place == "left"


def test_the_replay_against_the_recorded_steps(runs):
    """Recomputed by loops from the positions and costs of all steps."""
    group = next(group for group in read_groups([runs.folder], []) if group.task == "Drift-v0")
    for run in group.runs:
        positions = steps_of(runs.folder, f"Drift-v0/{run.seed}", "positions")
        costs = steps_of(runs.folder, f"Drift-v0/{run.seed}", "costs/cost")
        replay, records = run.replay(), run.records
        windows = records.start_step * 60 // records.length.sum()  # sixtieths of training
        told = replay.episodes
        columns = (replay.windows, told.start_step, told.length, told.cost)
        drawn, unsafe = [], []
        for window, start, length, cost in zip(*columns, strict=True):
            rows = np.flatnonzero(windows == window)
            share = (records.longest_streak / records.length)[rows]
            row = rows[int(np.argmax(share))]
            assert (start, length) == (records.start_step[row], records.length[row])
            own = slice(start, start + length)
            assert cost == costs[own].sum()
            unsafe += (costs[own] > 0).tolist()
            drawn += positions[own][shown_states(length)].tolist()
        assert replay.unsafe.tolist() == unsafe
        size = positions.max(axis=0) - positions.min(axis=0)
        off = np.abs(replay.box[0] + replay.points * (replay.box[1] - replay.box[0]) / 1023 - drawn)
        assert (off <= 0.51 * size / 1023 + 1e-6).all()


def test_the_replay_takes_the_worst_of_each_window():
    few = EpisodeRecords(
        np.arange(4), [0, 1, 2, 3], [1, 1, 1, 1], np.zeros(4), [0, 1, 1, 0], [0, 1, 1, 0]
    )
    assert replay_rows(few, 240) == [(0, 1)]  # the first of two equal ones
    assert replay_rows(few, 60) == [(0, 0), (1, 1), (2, 2), (3, 3)]


@pytest.mark.parametrize("values", [(0.0, 1.0), (0.0, 0.25, 1.0, 3.5), (0.0,), (2.0,)])
def test_packed_costs_are_unpacked_as_they_were(values):
    costs = np.random.default_rng(0).choice(values, 1003)
    packed = pack_costs(costs)
    assert ("values" in packed) == (not set(values) <= {0.0, 1.0})
    np.testing.assert_array_equal(unpack_costs(packed, ""), costs)


def test_the_view_of_a_task_and_errors_in_it(monkeypatch):
    assert view_of("Circle2D-1-v0", {}).axes[0].startswith("x")
    assert view_of("circle2d_mj:Circle2D-1-v0", {"constraint_radius": 3.0}).extent[1] > 3
    assert view_of("Drift-v0", {}) is Drift.view
    assert view_of("Target-v0", {}) is None
    assert view_of("no_such_module:Nowhere-v0", {}) is None
    monkeypatch.setattr(Drift.view, "positions", lambda observation, info: observation[..., :1])
    with pytest.raises(UserError, match=r"must give positions \[6, 2\], got \[6, 1\]"):
        agents.train("trpo-lag", "Drift-v0", **OPTIONS)
    monkeypatch.setattr(Drift.view, "positions", lambda observation, info: np.nan * observation)
    with pytest.raises(UserError, match=r"the view of task 'Drift-v0' gives positions .*finite"):
        agents.train("trpo-lag", "Drift-v0", **OPTIONS)
    monkeypatch.setattr(Drift.view, "positions", lambda observation, info: info["height"])
    with pytest.raises(UserError, match=r"the view of .* needs info\['height'\]"):
        agents.train("trpo-lag", "Drift-v0", **OPTIONS)
