"""Pictures of the scene and the environments' render modes, with the OpenGL that is installed."""

import copy
import pickle
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import circle2d_mj
from circle2d_mj import Circle2DConfig, Circle2DEnv, Circle2DVectorEnv
from circle2d_mj.circle2d.mujoco_envs import Circle2DMuJoCoEnv, Circle2DMuJoCoVectorEnv
from circle2d_mj.circle2d.view import Circle2DView
from circle2d_mj.core.view import histogram
from circle2d_mj.render import canvas
from circle2d_mj.render.renderer import Renderer

BALL = (217, 26, 115)
pytestmark = pytest.mark.usefixtures("opengl")


def ball(picture):
    """Return the mean column and row of the agent's pixels, and their number."""
    like = (np.abs(picture.astype(int) - BALL) <= 3).all(axis=-1)
    rows, columns = np.nonzero(like)
    assert len(rows), "no agent"
    return np.array((columns.mean(), rows.mean())) + 0.5, len(rows)


def expected_at(config, position, size):
    x, y = np.asarray(position) / config.arena
    return np.array((1 + x, 1 - y)) * size / 2


@pytest.mark.parametrize(
    "parameters",
    [
        {},
        {"level": 3, "init_radius_multiplier": 1.05},
        {"level": 0, "constraint_radius": 0.001, "init_radius_multiplier": 3.0},
        {"constraint_radius": 1e-9},  # from here on beyond what the physics or its camera allows
        {"constraint_radius": 100.0, "optima_perturbation": (30.0, -40.0)},
        {"constraint_radius": 1e8, "init_radius_multiplier": 12.0},
        {"init_radius_multiplier": 500.0},
        {"level": 0, "corridor_height_factor": 0.01},
    ],
)
def test_the_ball_is_where_the_agent_is(parameters):
    """Within a pixel at 10 points; at edges and corners of the arena, where the picture cuts it,
    within four."""
    config, size = Circle2DConfig(**parameters), 240
    rng = np.random.default_rng(0)
    with Renderer(config, size) as renderer:
        np.testing.assert_array_equal(renderer.frame(), renderer.background)
        for point in rng.uniform(-0.95, 0.95, (10, 2)) * config.arena:
            place, pixels = ball(renderer.frame(point))
            assert np.abs(place - expected_at(config, point, size)).max() < 1
            assert pixels > 12
        for corner in np.array([(1, 1), (-1, -1), (1, 0), (0, -1)]):
            place, _ = ball(renderer.frame(corner * config.arena))
            assert np.abs(place - expected_at(config, corner * config.arena, size)).max() < 4
        np.testing.assert_array_equal(renderer.frame(), renderer.background)


@pytest.mark.parametrize("size", [1, 33, 250])
def test_a_frame_without_agent_is_the_floor(size):
    """Exactly and for any width, though OpenGL aligns rows of pixels to 4 bytes by default."""
    with Renderer(Circle2DConfig(level=3), size) as renderer:
        np.testing.assert_array_equal(renderer.frame(), renderer.background)
        noise = np.random.default_rng(0).integers(0, 256, (size, size, 3), dtype=np.uint8)
        before = noise.copy()
        picture = renderer.frame(floor=noise)
        np.testing.assert_array_equal(picture, before)
        np.testing.assert_array_equal(noise, before)
        noise[:] = 7  # the same array, changed since
        assert (renderer.frame(floor=noise) == 7).all()
        np.testing.assert_array_equal(renderer.frame(), renderer.background)
        np.testing.assert_array_equal(picture, before)  # the caller's own array


def test_trajectories_and_heat_are_those_of_the_canvas():
    config = Circle2DConfig(level=2)
    path = np.linspace((12.0, 1.0), (-3.0, 6.0), 12)
    costs = config.region.contains(path[1:]).astype(float)
    with Renderer(config, 200) as renderer:
        view = Circle2DView(config)
        background, ground = renderer.background, view.background(200)
        painted = canvas.with_trajectories(ground, view.extent, [path], [costs])
        trajectories = renderer.trajectories([path], [costs])
        np.testing.assert_array_equal(trajectories, view.overlay(painted))
        painted = canvas.with_counts(ground, histogram(view.extent, path, 25), 5)
        heat = renderer.heatmap(path, cells=25, most=5)
        np.testing.assert_array_equal(heat, view.overlay(painted))
        np.testing.assert_array_equal(renderer.heatmap(np.zeros((0, 2))), background)
        assert (trajectories != background).any()


def test_bad_input_is_named():
    with Renderer(Circle2DConfig(), 32) as renderer:
        before = renderer.frame((5.0, 5.0))
        for position in (3.0, [(1, 2)], (np.nan, 0), "here"):
            with pytest.raises(ValueError, match="position must be two finite numbers, got"):
                renderer.frame(position)
        for floor in (np.zeros((16, 16, 3), np.uint8), np.zeros((32, 32, 3)), before[..., 0]):
            with pytest.raises(ValueError, match=r"floor must be a picture \[32, 32, 3\] uint8"):
                renderer.frame(floor=floor)
        for name in ("cells", "most"):
            with pytest.raises(ValueError, match=f"{name} must be at least 1, got 0"):
                renderer.heatmap(np.zeros((1, 2)), **{name: 0})
        np.testing.assert_array_equal(renderer.frame((5.0, 5.0)), before)
    for size, error in ((0, ValueError), (True, TypeError)):
        with pytest.raises(error, match="size must be"):
            Renderer(Circle2DConfig(), size)


SINGLE = [Circle2DEnv, Circle2DMuJoCoEnv]
VECTOR = [Circle2DVectorEnv, Circle2DMuJoCoVectorEnv]


@pytest.mark.parametrize("make", SINGLE)
def test_rgb_array(make):
    """The picture follows the agent, through steps, resets and a close."""
    env = make(level=1, render_mode="rgb_array")
    env.reset(seed=0)
    env.action_space.seed(0)
    for k in range(4):
        picture = env.render()
        assert (picture.shape, picture.dtype) == ((640, 640, 3), np.uint8)
        place, _ = ball(picture)
        assert np.abs(place - expected_at(env.config, env.position, 640)).max() < 1
        env.step(env.action_space.sample() - 1)
        assert np.abs(place - expected_at(env.config, env.position, 640)).max() > 2
        if k == 2:
            env.close()
            env.close()
            env.reset()
    drawn_by = env._envs.simulation._drawer
    env.close()
    with pytest.raises(RuntimeError, match="closed"):
        drawn_by.frame()
    still = make(level=1)
    still.reset(seed=0)
    assert still.render() is None
    still.close()


@pytest.mark.parametrize("make", VECTOR)
def test_rgb_array_of_many(make):
    envs = make(3, level=3, render_mode="rgb_array")
    envs.reset(seed=5)
    with Renderer(envs.config) as renderer:
        for _ in range(2):
            pictures = envs.render()
            assert isinstance(pictures, tuple)
            expected = [renderer.frame(position) for position in envs.position]
            np.testing.assert_array_equal(pictures, expected)
            envs.step(np.full((3, 2), -1.0))
    envs.close()
    envs.close()
    assert make(2, level=0).render() is None


@pytest.mark.parametrize("make", SINGLE)
def test_human_mode_shows_every_state(make, monkeypatch):
    monkeypatch.setitem(circle2d_mj.circle2d.envs.METADATA, "render_modes", ["rgb_array", "human"])
    env, shown = make(level=1, render_mode="human"), []
    monkeypatch.setattr(env._envs.simulation, "show", lambda i: shown.append((i, *env.position)))
    env.reset(seed=0)
    expected = [(0, *env.position)]
    for _ in range(2):
        env.step(np.array((-1.0, 0.0)))
        expected.append((0, *env.position))
    assert env.render() is None
    assert shown == [*expected, expected[-1]]
    env.close()


@pytest.mark.parametrize("make", [*SINGLE, lambda **kw: Circle2DVectorEnv(2, **kw)])
def test_copies_of_an_environment_that_has_rendered(make):
    env = make(level=2, render_mode="rgb_array")
    env.reset(seed=0)
    first = np.array(env.render())
    twin = copy.deepcopy(pickle.loads(pickle.dumps(env)))
    env.step(np.full(env.action_space.shape, -1.0))
    env.close()
    np.testing.assert_array_equal(np.array(twin.render()), first)
    twin.close()


@pytest.mark.parametrize("name", ["Circle2D-1-v0", "Circle2DMuJoCo-0-v0"])
def test_gymnasiums_check_of_render_modes(name, monkeypatch):
    monkeypatch.setitem(circle2d_mj.circle2d.envs.METADATA, "render_modes", ["rgb_array"])
    env = gym.make(name, render_mode="rgb_array").unwrapped
    with warnings.catch_warnings(record=True) as caught:  # it warns of a picture that is None
        warnings.simplefilter("always")
        check_env(env)
    assert not [str(w.message) for w in caught if "render" in str(w.message).lower()]
    env.close()
