"""The environments' render modes, with the OpenGL that is installed."""

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
from circle2d_mj.render import canvas
from circle2d_mj.render.gl import NoOpenGL

SINGLE = [Circle2DEnv, Circle2DMuJoCoEnv]
opengl = pytest.mark.usefixtures("opengl")


def disc(picture):
    """Return the mean column and row of the agent's pixels, and their number."""
    rows, columns = np.nonzero((picture == canvas.AGENT).all(axis=-1))
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
        {"constraint_radius": 1e-9},
        {"constraint_radius": 100.0, "optima_perturbation": (30.0, -40.0)},
        {"constraint_radius": 1e8, "init_radius_multiplier": 12.0},
        {"init_radius_multiplier": 500.0},
        {"level": 0, "corridor_height_factor": 0.01},
    ],
)
def test_the_disc_is_where_the_agent_is(parameters):
    """Within a pixel at 10 points; at edges and corners of the arena, where the picture cuts it,
    within four."""
    config, size = Circle2DConfig(**parameters), 240
    view, rng = Circle2DView(config), np.random.default_rng(0)
    arena = view.overlay(view.background(size))
    untouched = arena.copy()
    for point in rng.uniform(-0.95, 0.95, (10, 2)) * config.arena:
        place, pixels = disc(canvas.with_agent(arena, view.extent, point))
        assert np.abs(place - expected_at(config, point, size)).max() < 1
        assert pixels > 12
    for corner in np.array([(1, 1), (-1, -1), (1, 0), (0, -1)]):
        place, _ = disc(canvas.with_agent(arena, view.extent, corner * config.arena))
        assert np.abs(place - expected_at(config, corner * config.arena, size)).max() < 4
    np.testing.assert_array_equal(arena, untouched)


@pytest.mark.parametrize("make", SINGLE)
def test_plain_pictures_follow_the_agent_without_opengl(make, monkeypatch):
    """Through steps, resets and a close, also of many environments."""

    def nothing(*_):
        raise NoOpenGL("install one")

    monkeypatch.setattr("circle2d_mj.render.gl.Offscreen", nothing)
    env = make(level=1, render_mode="rgb_array")
    inwards = np.array((-1.0, 0.0))  # where no edge cuts the disc
    env.reset(seed=0)
    env.step(inwards)
    env.action_space.seed(0)
    for k in range(4):
        picture = env.render()
        assert (picture.shape, picture.dtype) == ((640, 640, 3), np.uint8)
        place, _ = disc(picture)
        assert np.abs(place - expected_at(env.config, env.position, 640)).max() < 1
        env.step(env.action_space.sample() - 1)
        assert np.abs(place - expected_at(env.config, env.position, 640)).max() > 4
        if k == 2:
            env.close()
            env.close()
            env.reset()
            env.step(inwards)
    env.close()
    still = make(level=1)
    still.reset(seed=0)
    assert still.render() is None
    many = Circle2DVectorEnv(3, level=3, render_mode="rgb_array")
    many.reset(seed=5)
    many.step(np.tile(inwards, (3, 1)))
    places = [disc(picture)[0] for picture in many.render()]
    np.testing.assert_allclose(places, expected_at_each(many), atol=1)


def expected_at_each(envs):
    return [expected_at(envs.config, position, 640) for position in envs.position]


@opengl
def test_mujocos_frames_are_drawn_until_the_environments_are_closed():
    envs = Circle2DMuJoCoVectorEnv(2, level=1, render_mode="rgb_array", camera="top")
    envs.reset(seed=5)
    pictures = envs.render()
    assert isinstance(pictures, tuple)
    for picture, place in zip(pictures, expected_at_each(envs), strict=True):
        red, green, blue = np.moveaxis(picture.astype(int), -1, 0)
        rows, columns = np.nonzero((red > 2 * green) & (blue > green))  # the ball
        assert np.abs((columns.mean() + 0.5, rows.mean() + 0.5) - place).max() < 2
    offscreen, data = envs.simulation._offscreen, envs.simulation.dynamics.data(0)
    envs.close()
    envs.close()
    with pytest.raises(RuntimeError, match="closed"):
        offscreen.draw(data, 0)
    np.testing.assert_array_equal(envs.render(), pictures)  # opened again
    envs.close()
    assert Circle2DMuJoCoVectorEnv(2, level=0).render() is None


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


@opengl
@pytest.mark.parametrize(
    "make",
    [
        *SINGLE,
        lambda **kw: Circle2DVectorEnv(2, **kw),
        lambda **kw: Circle2DMuJoCoEnv(camera="top", **kw),
    ],
)
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
