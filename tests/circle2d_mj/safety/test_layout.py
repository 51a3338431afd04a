"""Where SafetyPointGoal1-v0 puts things, beside plain loops that sample as the original does."""

import numpy as np
import pytest
from scipy import stats

from circle2d_mj.core.streams import Streams
from circle2d_mj.safety import layout, rules
from circle2d_mj.safety.circle import SafetyPointCircle
from circle2d_mj.safety.goal import SafetyPointGoal

N = 10_000
NAMES = ["agent", "goal", *[f"hazard{i}" for i in range(8)], "vase0"]
KEEPOUT = dict.fromkeys(NAMES, 0.18) | {"agent": 0.4, "goal": 0.305, "vase0": 0.15}


def started(make, n=N, seed=0):
    task = make(n)
    task.start(Streams(np.arange(seed, seed + n, dtype=np.uint64)), np.arange(n))
    return task


@pytest.fixture(scope="module")
def ours():
    return started(SafetyPointGoal)


def draw(rng, name, others):
    """A place for an object, or None after 100 tries: as in the original's task code."""
    limit = 1.5 - KEEPOUT[name]
    for _ in range(100):
        place = rng.uniform(-limit, limit, 2)
        if all(np.hypot(*(place - p)) >= KEEPOUT[name] + KEEPOUT[o] for o, p in others.items()):
            return place
    return None


def plain_layouts(n):
    rng = np.random.default_rng(0)
    layouts = []
    while len(layouts) < n:
        places = {}
        for name in NAMES:
            if (place := draw(rng, name, places)) is None:
                break
            places[name] = place
        else:
            del places["goal"]  # it is drawn a second time, after all others
            places["goal"] = draw(rng, "goal", places)
            layouts.append([places[name] for name in NAMES])
    return np.array(layouts)


def apart(places):
    return np.linalg.norm(places[:, :, None] - places[:, None], axis=-1)


def test_keepouts_and_ranges(ours):
    places = ours.state_dict()["places"]
    keepout = np.array([KEEPOUT[name] for name in NAMES])
    needed = keepout[:, None] + keepout
    np.fill_diagonal(needed, 0)
    assert (apart(places) >= needed).all()
    assert (np.abs(places) <= 1.5 - keepout[:, None]).all()
    assert (np.abs(places).max(axis=(0, 2)) > 1.49 - keepout).all()
    assert (rules.goal_cost(rules.sight(places[:, 0], places[:, 2:10]).distance) == 0).all()
    assert len(np.unique(places.reshape(N, -1), axis=0)) == N


def test_layouts_are_distributed_like_the_originals(ours):
    """Two-sample Kolmogorov-Smirnov tests of places and of distances."""
    places, plain = ours.state_dict()["places"], plain_layouts(1500)
    near, plain_near = apart(places), apart(plain)
    values = [
        (places[:, i, 0] + places[:, i, 1], plain[:, i, 0] + plain[:, i, 1]) for i in range(11)
    ]
    values += [(places[:, i, 0], plain[:, i, 0]) for i in range(11)]
    for i, j in [(0, 1), (0, 2), (0, 9), (1, 2), (1, 10), (2, 9), (0, 10)]:
        values.append((near[:, i, j], plain_near[:, i, j]))
    values.append((near[:, 0, 2:10].min(axis=1), plain_near[:, 0, 2:10].min(axis=1)))
    assert min(stats.ks_2samp(*pair).pvalue for pair in values) > 1e-3 / len(values)


def test_start_poses(ours):
    """Headings and the vase's are uniform; all is at rest; sensors show gravity alone."""
    turn = 2 * np.arctan2(ours.qpos[:, 9], ours.qpos[:, 6])
    for angle in (ours.qpos[:, 2], turn):
        assert stats.kstest(angle, stats.uniform(0, 2 * np.pi).cdf).pvalue > 1e-3
    np.testing.assert_allclose(np.linalg.norm(ours.qpos[:, 6:], axis=1), 1, atol=1e-12)
    np.testing.assert_array_equal(
        ours.qpos[:, 3:6], np.c_[ours.state_dict()["places"][:, 10], [0.09996] * N]
    )
    np.testing.assert_array_equal(ours.qvel, 0)
    np.testing.assert_allclose(ours.observe()[:, :9], [[0, 0, 9.81] + [0] * 6] * N, atol=1e-12)


def test_circle_starts():
    task = started(SafetyPointCircle)
    for column, law in enumerate([stats.uniform(-0.8, 1.6)] * 2 + [stats.uniform(0, 2 * np.pi)]):
        assert stats.kstest(task.qpos[:, column], law.cdf).pvalue > 1e-3
    assert np.abs(np.corrcoef(task.qpos.T) - np.eye(3)).max() < 0.03
    np.testing.assert_array_equal(task.qvel, 0)
    np.testing.assert_allclose(task.observe()[:, :3], [[0, 0, 9.81]] * N, atol=1e-12)


def test_a_reached_goal_moves():
    n = 500
    task = started(SafetyPointGoal, n)
    before = task.state_dict()["places"]
    task.qpos[:, :2] = before[:, 1] + [0.1, 0.0]  # the agents stand in their goals
    task.qpos[::2, 3:5] = [2.0, 2.0]  # and half of the vases have left the arena
    places = before.copy()
    places[:, 0], places[:, 10] = task.qpos[:, :2], task.qpos[:, 3:5]
    task.load_state_dict({**task.state_dict(), "places": places})
    reward, terminated, info = task.step(np.zeros((n, 2)))
    np.testing.assert_allclose(reward, 1.0, atol=1e-9)
    assert not terminated.any()
    np.testing.assert_array_equal(info["goal_met"], 1.0)
    after = task.state_dict()["places"]
    np.testing.assert_array_equal(np.delete(after, 1, 1)[:, 1:9], np.delete(before, 1, 1)[:, 1:9])
    assert (after[:, 1] != before[:, 1]).all()
    keepout = np.array([KEEPOUT[name] for name in NAMES])
    room = apart(after)[:, 1] - keepout - keepout[1]
    assert (np.delete(room, 1, 1) >= 0).all()
    assert (np.abs(after[:, 1]) <= 1.5 - 0.305).all()
    # The observation shows the new goal, and the next reward counts from it.
    ahead = rules.lidar(rules.sight(after[:, 0], after[:, 1:2]), task.qpos[:, 2], 3.0)
    np.testing.assert_array_equal(task.observe()[:, 12:28], ahead)
    reward, _, info = task.step(np.zeros((n, 2)))
    assert np.abs(reward).max() < 1e-6
    assert not info["goal_met"].any()


def test_new_goals_are_distributed_like_the_originals():
    """Many goals among the same other objects, which stand where the agent could push them."""
    n = 4000
    places = np.repeat(plain_layouts(1), n, axis=0)
    goals, found = layout.sample_goal(Streams(np.arange(n, dtype=np.uint64)), np.arange(n), places)
    assert found.all()
    rng = np.random.default_rng(1)
    others = {name: places[0, i] for i, name in enumerate(NAMES) if name != "goal"}
    plain = np.array([draw(rng, "goal", others) for _ in range(1000)])
    for direction in ([1, 0], [0, 1], [1, 1], [1, -1]):
        assert stats.ks_2samp(goals @ direction, plain @ direction).pvalue > 1e-3


def test_an_episode_terminates_where_no_goal_can_be_placed(monkeypatch):
    task = started(SafetyPointGoal, 3)
    places = task.state_dict()["places"]
    task.qpos[1, :2] = places[1, 1]
    monkeypatch.setattr(layout, "KEEPOUT", layout.KEEPOUT + 9)
    _, terminated, info = task.step(np.zeros((3, 2)))
    np.testing.assert_array_equal(terminated, [False, True, False])
    np.testing.assert_array_equal(info["goal_met"], [0, 1, 0])
    np.testing.assert_array_equal(task.state_dict()["places"][:, 1], places[:, 1])


def test_crowded_layouts_start_over():
    """Six objects that need more than half of the square: many attempts end in a dead end."""
    keepout, index = np.full(6, 0.42), np.arange(30)
    streams = Streams(index.astype(np.uint64))
    places = layout.sample_layout(streams, index, keepout)
    near = apart(places) + 9 * np.eye(6)
    assert near.min() >= 0.84
    assert streams.counters.max() > 3 * streams.counters.min()  # some took several attempts
    alone = Streams(np.array([17], dtype=np.uint64))
    np.testing.assert_array_equal(
        layout.sample_layout(alone, np.array([0]), keepout), places[17:18]
    )
    with pytest.raises(RuntimeError, match="no layout found in 3 attempts"):
        layout.sample_layout(streams, index, np.full(6, 0.6), layout_tries=3)


def test_lidar_against_a_plain_loop():
    """The specification, one target at a time."""
    rng = np.random.default_rng(0)
    position, heading = rng.uniform(-2, 2, (50, 2)), rng.uniform(-9, 9, 50)
    targets = rng.uniform(-2, 2, (50, 10, 2))
    groups = np.array((0, *[1] * 8, 2))
    expected = np.zeros((50, 3, 16))
    size = 2 * np.pi / 16
    for i in range(50):
        cos, sin = np.cos(heading[i]), np.sin(heading[i])
        for k in range(10):
            dx, dy = targets[i, k] - position[i]
            x, y = cos * dx + sin * dy, cos * dy - sin * dx
            angle = np.arctan2(y, x) % (2 * np.pi)
            b = int(angle / size)
            s = max(0, 3.0 - np.hypot(x, y)) / 3.0
            share = (angle - b * size) / size
            row = expected[i, groups[k]]
            for at, value in [(b, s), (b + 1, share * s), (b - 1, (1 - share) * s)]:
                row[at % 16] = max(row[at % 16], value)
    seen = rules.lidar(rules.sight(position, targets), heading, 3.0, groups)
    np.testing.assert_allclose(seen, expected.reshape(50, 48), atol=1e-12)
    one = rules.lidar(
        rules.sight(position[3], targets[3]), heading[3], 3.0, groups
    )  # no leading axes
    np.testing.assert_array_equal(one, seen[3])
