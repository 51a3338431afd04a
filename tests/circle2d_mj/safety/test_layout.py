"""Layouts: the suite's rules of placement, and PointGoal1 against loops like the original's."""

import numpy as np
import pytest
from safety_golden import parameters
from scipy import stats

from circle2d_mj.core.streams import Streams
from circle2d_mj.safety import layout, worlds
from circle2d_mj.safety.families import ButtonTask, CircleTask, GoalTask, PushTask, RunTask
from circle2d_mj.safety.robots import AGENTS

FAMILIES = {c.family: c for c in (GoalTask, ButtonTask, PushTask, CircleTask, RunTask)}
NAMES = ["agent", "goal", *[f"hazard{i}" for i in range(8)], "vase0"]
KEEPOUT = dict.fromkeys(NAMES, 0.18) | {"agent": 0.4, "goal": 0.305, "vase0": 0.15}


def started(family, agent="Point", level=1, n=200, seed=0):
    task = FAMILIES[family](agent, level, n)
    task.start(Streams(np.arange(seed, seed + n, dtype=np.uint64)), np.arange(n))
    return task


def apart(places):
    return np.linalg.norm(places[:, :, None] - places[:, None], axis=-1)


def names(task):
    """Return the original's name for each row of the layout."""
    found = ["agent"]
    for placed in task.world.scene.placed:
        found += worlds.names(task.world.kinds[placed.kind], placed.number)
    return found


@pytest.mark.parametrize("agent", AGENTS)
@pytest.mark.parametrize("family", ["Goal", "Button", "Push", "Circle", "Run"])
def test_placements(family, agent):
    """Keepouts and extents are the original's, as recorded; no start has a cost."""
    for level in range(1 if family == "Run" else 3):
        recorded = parameters(f"Safety{agent}{family}{level}-v0")
        task = started(family, agent, level, n=60)
        placed = {k: v for k, v in recorded["placements"].items() if "sigwall" not in k}
        assert names(task) == list(placed)
        places, half = task.places, recorded["extents"][2]
        goal = names(task).index("goal") if "goal" in placed else None
        for i, (rectangles, keepout) in enumerate(placed.values()):
            if family == "Button" and i == goal:
                continue  # the goal has moved to its button
            if rectangles is None:
                assert (np.abs(places[:, i]) <= half - keepout).all()
            else:
                left, bottom, right, top = rectangles[0]
                assert (places[:, i] >= np.array([left, bottom]) - 2e-9).all()
                assert (places[:, i] <= np.array([right, top]) + 2e-9).all()
            for k, (_, other) in enumerate(list(placed.values())[:i]):
                if not (family == "Button" and k == goal):
                    distance = np.linalg.norm(places[:, i] - places[:, k], axis=1)
                    assert (distance >= keepout + other).all()
        assert all((cost == 0).all() for cost in task._costs().values())
        assert task.observation_space.shape == (recorded["observation_size"],)
        shown = [key for key in recorded["obs_layout"] if "lidar" in key]
        assert [f"{kind}_lidar" for kind in task.world.scene.lidars] == shown


def draw(rng, name, others):
    """Return a place for an object, or None after 100 tries, as the original's task code does."""
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


def test_layouts_are_distributed_like_the_originals():
    """Two-sample Kolmogorov-Smirnov tests of places and distances; as in the original, the goal is
    drawn a second time."""
    places, plain = started("Goal", n=6000).places, plain_layouts(1500)
    near, plain_near = apart(places), apart(plain)
    values = [(places[:, i, 0], plain[:, i, 0]) for i in range(11)]
    values += [(places[:, i].sum(axis=-1), plain[:, i].sum(axis=-1)) for i in range(11)]
    pairs = [(0, 1), (0, 2), (0, 9), (1, 2), (1, 10), (2, 9), (0, 10)]
    values += [(near[:, i, j], plain_near[:, i, j]) for i, j in pairs]
    values += [(near[:, 0, 2:10].min(axis=1), plain_near[:, 0, 2:10].min(axis=1))]
    assert min(stats.ks_2samp(*pair).pvalue for pair in values) > 1e-3 / len(values)


def test_start_poses():
    """Places and headings are uniform; everything is at rest; sensors show only gravity."""
    circle = started("Circle", n=6000)
    for column, law in enumerate([stats.uniform(-0.8, 1.6)] * 2 + [stats.uniform(0, 2 * np.pi)]):
        assert stats.kstest(circle.qpos[:, column], law.cdf).pvalue > 1e-3
    assert np.abs(np.corrcoef(circle.qpos.T) - np.eye(3)).max() < 0.04
    ours = started("Goal", n=6000)
    turn = 2 * np.arctan2(ours.qpos[:, 9], ours.qpos[:, 6])
    for angle in (ours.qpos[:, 2], turn):
        assert stats.kstest(angle, stats.uniform(0, 2 * np.pi).cdf).pvalue > 1e-3
    np.testing.assert_array_equal(ours.qpos[:, 3:6], np.c_[ours.places[:, 10], [0.09996] * 6000])
    np.testing.assert_array_equal(ours.qvel, 0)
    np.testing.assert_allclose(ours.observe()[:, :9], [[0, 0, 9.81] + [0] * 6] * 6000, atol=1e-12)
    car = started("Button", "Car", n=300)
    heading = 2 * np.arctan2(car.qpos[:, 6], car.qpos[:, 3])
    assert stats.kstest(heading, stats.uniform(0, 2 * np.pi).cdf).pvalue > 1e-3
    np.testing.assert_array_equal(car.qpos[:, 2], 0.1)
    assert np.bincount(car.goal_button, minlength=4).min() > 40
    place = car.places[np.arange(300), 1 + car.goal_button]
    np.testing.assert_array_equal(car.places[:, 5], place)


def at_goals(task):
    """Put the agents, or with Push the boxes, on their goals."""
    state, goal = task.state_dict(), task.world.rows["goal"].start
    first = 1 + (3 if task.family == "Push" else 0)  # after the time
    state["mujoco"][:, first : first + 2] = state["layout"][:, goal] + [0.1, 0.0]
    task.load_state_dict(state)


@pytest.mark.parametrize("family", ["Goal", "Push"])
def test_a_reached_goal_moves(family):
    n = 200
    task = started(family, n=n)
    at_goals(task)
    before, goal = task.places, task.world.rows["goal"].start
    reward, terminated, info = task.step(np.zeros((n, 2)))
    assert not terminated.any()
    np.testing.assert_array_equal(info["goal_met"], 1.0)
    np.testing.assert_allclose(reward, 1.0, atol=1e-2)  # the box may settle
    after = task.places
    kept = [i for i, name in enumerate(names(task)) if name[:6] in ("hazard", "pillar")]
    np.testing.assert_array_equal(after[:, kept], before[:, kept])
    assert (after[:, goal] != before[:, goal]).all()
    keepout = task.world.areas.keepout
    room = apart(after)[:, goal] - keepout - keepout[goal]
    assert (np.delete(room, goal, 1) >= -1e-3).all()
    assert (np.abs(after[:, goal]) <= 1.5 - keepout[goal]).all()
    reward, _, info = task.step(np.zeros((n, 2)))
    assert np.abs(reward).max() < 1e-2
    assert not info["goal_met"].any()


def test_an_episode_terminates_if_no_goal_can_be_placed():
    task = started("Goal", n=3)
    before = task.places
    task.qpos[1, :2] = before[1, 1]
    task.load_state_dict(task.state_dict())
    task.world = task.world._replace(
        areas=task.world.areas._replace(keepout=task.world.areas.keepout + 9)
    )
    _, terminated, info = task.step(np.zeros((3, 2)))
    np.testing.assert_array_equal(terminated, [False, True, False])
    np.testing.assert_array_equal(info["goal_met"], [0, 1, 0])
    np.testing.assert_array_equal(task.places[:, 1], before[:, 1])


def test_crowded_layouts_start_over():
    """Six objects need more than half of the square, so that many attempts fail."""

    def areas(keepout):
        half = np.full((6, 2), 1.5 - keepout)
        return layout.Areas(np.zeros((6, 2)), half, np.full(6, keepout))

    index = np.arange(30)
    streams = Streams(index.astype(np.uint64))
    places = layout.sample_layout(streams, index, areas(0.42))
    near = apart(places) + 9 * np.eye(6)
    assert near.min() >= 0.84
    assert streams.counters.max() > 3 * streams.counters.min()  # some took several attempts
    alone = Streams(np.array([17], dtype=np.uint64))
    np.testing.assert_array_equal(
        layout.sample_layout(alone, np.array([0]), areas(0.42)), places[17:18]
    )
    with pytest.raises(RuntimeError, match="no layout found in 3 attempts"):
        layout.sample_layout(streams, index, areas(0.6), layout_tries=3)
