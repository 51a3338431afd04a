"""Pictures of the Safety tasks: what is where in the world is there in the picture."""

import copy

import gymnasium as gym
import numpy as np
import pytest

GOAL, CIRCLE, HOPPER = (
    f"circle2d_mj/{name}"
    for name in ("SafetyPointGoal1-v0", "SafetyPointCircle1-v0", "SafetyHopperVelocity-v1")
)
BUTTON, PUSH = "circle2d_mj/SafetyCarButton2-v0", "circle2d_mj/SafetyPointPush2-v0"
HALF_HEIGHT = 2.5  # of the top camera's view, m


def centre(picture, like):
    """World coordinates of the middle of the pixels that `like` picks, [2]."""
    rows, columns = np.nonzero(like(*np.moveaxis(picture.astype(int), -1, 0)))
    assert len(rows) > 50
    size = len(picture)
    middle = np.array([columns.mean() + 0.5, rows.mean() + 0.5]) / size
    return (2 * middle - 1) * (HALF_HEIGHT, -HALF_HEIGHT)


@pytest.mark.parametrize("seed", [0, 1])
def test_goal_and_vase_are_drawn_where_they_are(opengl, seed):
    env = gym.make(GOAL, render_mode="rgb_array")
    env.reset(seed=seed)
    task = env.unwrapped._envs.simulation
    for _ in range(2):  # a goal that moves moves in the picture
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
    """Ten steps of 2 or 4 ms, or Hopper's four of 2 ms."""
    assert gym.make(f"circle2d_mj/{task}").metadata["render_fps"] == fps
    assert gym.make_vec(f"circle2d_mj/{task}", 2).metadata["render_fps"] == fps
