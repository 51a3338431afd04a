"""Views and pictures of the Safety tasks, against their simulations and plain geometry."""

import copy

import gymnasium as gym
import numpy as np
import pytest

from circle2d_mj.registration import SAFETY
from circle2d_mj.render import canvas

GOAL, CIRCLE, HOPPER, BUTTON, PUSH = (
    f"circle2d_mj/Safety{name}"
    for name in (
        "PointGoal1-v0",
        "PointCircle1-v0",
        "HopperVelocity-v1",
        "CarButton2-v0",
        "PointPush2-v0",
    )
)
WITHOUT = ("Goal0", "Button0", "Push0")
SHOWN = [name for name in SAFETY if not any(scene in name for scene in WITHOUT)]
SIZE = 300


def driven(name, steps, n=16):
    """Yield the environments, positions [n, 2], costs [n] and ends [n] of random steps; an action
    lasts 20 steps."""
    envs = gym.make_vec(name, n, vectorization_mode="vector_entry_point")
    observation, info = envs.reset(seed=0)
    rng, shape = np.random.default_rng(0), envs.action_space.shape
    actions = np.repeat([rng.uniform(-1, 1, shape) for _ in range(steps // 20 + 1)], 20, axis=0)
    for action in actions[:steps]:
        observation, _, terminated, truncated, info = envs.step(action)
        yield envs, envs.view.positions(observation, info), info["cost"], terminated | truncated


@pytest.mark.parametrize(("name", "steps"), [(CIRCLE, 120), (GOAL, 120), (HOPPER, 60)])
def test_states_that_cost_lie_on_what_is_shaded(name, steps):
    """The background is shaded at the position of a step exactly if the step has a cost."""
    seen, view = set(), gym.make(name).get_wrapper_attr("view")
    background = view.background(SIZE)
    edge = view.overlay(np.full_like(background, 128)) != 128
    for envs, positions, cost, _ in driven(name, steps):
        at = canvas.pixels(envs.view.extent, positions, SIZE)
        inside = ((at >= 0) & (at < SIZE)).all(axis=1)
        for (column, row), costs in zip(at[inside].astype(int), cost[inside], strict=True):
            if not edge[row, column].any():  # next to the border, within a pixel
                shaded = (background[row, column] == canvas.REGION).all()
                assert shaded == (costs > 0)
                seen.add(bool(shaded))
    assert seen == {True, False}


def test_the_circle_shows_where_the_agents_are():
    for envs, positions, _, _ in driven(CIRCLE, 5):
        np.testing.assert_array_equal(positions, envs.simulation.qpos[:, :2])
    view = envs.view
    assert view.axes == ("x (m)", "y (m)")
    blank = np.full((SIZE, SIZE, 3), 128, dtype=np.uint8)
    image = view.overlay(blank)
    walls = [canvas.pixels(view.extent, (x, 2.3), SIZE).astype(int) for x in (-1.125, 1.125)]
    around = [
        canvas.pixels(view.extent, 1.5 * np.array([np.cos(a), np.sin(a)]), SIZE).astype(int)
        for a in np.linspace(0.3, 6.0, 9)
    ]
    for column, row in (*walls, *around):
        assert image[row - 2 : row + 3, column - 2 : column + 3].min() < 90


def test_the_goal_shows_distances():
    """From the agent to the goal and to the nearest hazard, up to the lidars' reach."""
    farthest = 0.0
    for envs, positions, _, ended in driven(GOAL, 150):
        places = envs.simulation.places
        from_agent = np.linalg.norm(places[:, 1:] - places[:, :1], axis=-1)
        expected = np.stack((from_agent[:, 0], from_agent[:, 1:9].min(axis=1)), axis=1)
        np.testing.assert_allclose(positions, np.minimum(expected, 3.0), atol=1e-12)
        farthest = max(farthest, expected.max())
        assert not ended.any()
    assert farthest > 2.0
    background = envs.view.background(SIZE)
    column, row = canvas.pixels(envs.view.extent, (0.15, 1.0), SIZE).astype(int)
    assert tuple(background[row, column]) not in (canvas.REGION, canvas.FREE)  # the goal


def test_the_hopper_shows_its_height():
    for envs, positions, _, _ in driven(HOPPER, 30):
        np.testing.assert_array_equal(positions[:, 1], envs.simulation.qpos[:, 1])


def test_scenes_without_hazards_have_no_view():
    for name in set(SAFETY) - set(SHOWN):
        assert gym.make(name).get_wrapper_attr("view") is None
    assert len(SHOWN) == 56


@pytest.mark.parametrize("name", SHOWN)
def test_the_view_of_an_environment(name):
    """It is found through wrappers, takes one state or many, and names no places."""
    env = gym.make(name)
    view = env.get_wrapper_attr("view")
    observation, info = env.reset(seed=0)
    one = view.positions(observation, info)
    assert one.shape == (2,)
    left, right, bottom, top = view.extent
    assert left <= one[0] <= right
    assert bottom <= one[1] <= max(top, 3.0)  # the lidars' reach
    assert view.places(one[None]) == []
    several = {key: np.array([value] * 6).reshape(2, 3) for key, value in info.items()}
    many = view.positions(np.tile(observation, (2, 3, 1)), several)
    np.testing.assert_array_equal(many, np.tile(one, (2, 3, 1)))
    assert len(view.axes) == 2
    size = 520
    grey = np.full((size, size, 3), 128, dtype=np.uint8)
    shown = view.overlay(grey)
    assert shown.shape == grey.shape
    # The axes: ticks at the lower and left edges, the name of the second axis at the top.
    for edge in (shown[-2], shown[:, 1], shown[10:30, 10:60].reshape(-1, 3)):
        assert (edge < 90).all(axis=-1).sum() > 1


HALF_HEIGHT = 2.5  # of the top camera's view, m


def centre(picture, like):
    """Return the world coordinates, [2], of the mean of the pixels that `like` selects."""
    rows, columns = np.nonzero(like(*np.moveaxis(picture.astype(int), -1, 0)))
    assert len(rows) > 50
    size = len(picture)
    middle = np.array([columns.mean() + 0.5, rows.mean() + 0.5]) / size
    return (2 * middle - 1) * (HALF_HEIGHT, -HALF_HEIGHT)


def test_goal_and_vase_are_drawn_where_they_are(opengl):
    env = gym.make(GOAL, render_mode="rgb_array")
    env.reset(seed=0)
    task = env.unwrapped._envs.simulation
    for _ in range(2):  # the goal moves between the pictures
        picture = env.render()
        assert (picture.shape, picture.dtype) == ((640, 640, 3), np.uint8)
        goal = centre(picture, lambda r, g, b: (g > r + 40) & (g > b + 40))
        np.testing.assert_allclose(goal, task.places[0, 1], atol=0.02)
        vase = centre(picture, lambda r, g, b: (b > r + 60) & (g > r + 60))
        np.testing.assert_allclose(vase, task.qpos[0, 3:5], atol=0.03)
        task._draw_goals(np.array([0]))
    env.close()


def test_the_agent_is_drawn_where_it_is(opengl):
    env = gym.make(CIRCLE, render_mode="rgb_array")
    env.reset(seed=3)
    for _ in range(3):
        for _ in range(15):
            env.step([1.0, 0.3])
        agent = centre(env.render(), lambda r, g, b: (r > g + 90) & (r > b + 90))
        qpos = env.unwrapped._envs.simulation.qpos[0]
        # Ball and arrow together: their middle lies a little ahead of the hinge.
        np.testing.assert_allclose(agent, qpos[:2], atol=0.06)
    env.close()


@pytest.mark.parametrize("task", [GOAL, CIRCLE, HOPPER, BUTTON, PUSH])
def test_pictures_change_nothing(opengl, task):
    env = gym.make(task, render_mode="rgb_array")
    env.reset(seed=1)
    assert env.render().std() > 5
    twin = copy.deepcopy(env.unwrapped)
    env.action_space.seed(0)
    for _ in range(5):
        action = env.action_space.sample()
        env.render()
        np.testing.assert_array_equal(env.step(action)[0], twin.step(action)[0])
    env.close()
    frames = gym.make_vec(task, num_envs=3, render_mode="rgb_array")
    frames.reset(seed=0)
    pictures = frames.render()
    assert len(pictures) == 3
    assert (pictures[0] != pictures[1]).any() or task == HOPPER
    frames.close()


@pytest.mark.parametrize(
    ("task", "fps"),
    [("SafetyPointCircle1-v0", 50), ("SafetyCarGoal1-v0", 25), ("SafetyHopperVelocity-v1", 125)],
)
def test_films_run_as_fast_as_the_task(task, fps):
    """A step is ten substeps of 2 or 4 ms, or four of 2 ms for the Hopper."""
    assert gym.make(f"circle2d_mj/{task}").metadata["render_fps"] == fps
    assert gym.make_vec(f"circle2d_mj/{task}", 2).metadata["render_fps"] == fps
