"""Circle2D's pictures and names of places, against geometry that shares no code with them."""

import gymnasium as gym
import numpy as np
import pytest

from circle2d_mj import Circle2DConfig
from circle2d_mj.circle2d import view
from circle2d_mj.circle2d.view import Circle2DView
from circle2d_mj.render import canvas


def centres(config, size):
    """Return the world coordinates of the pixels' centres: [size, size, 2]; the top row first."""
    steps = (np.arange(size) - (size - 1) / 2) * (2 * config.arena / size)
    return np.stack(np.meshgrid(steps, -steps), axis=-1)


def near_an_edge(mask, distance=1):
    """Return True for pixels that have a neighbour, up to a distance on each axis, of another
    value."""
    padded, width = np.pad(mask, distance, mode="edge"), range(2 * distance + 1)
    shifts = [padded[i : i + len(mask), j : j + len(mask)] for i in width for j in width]
    return np.any(shifts, axis=0) & ~np.all(shifts, axis=0)


@pytest.mark.parametrize(
    "parameters",
    [
        *({"level": level} for level in range(4)),
        {"level": 3, "corridor_height_factor": 0.9, "constraint_radius": 0.01},
        {"level": 2, "corridor_height_factor": 0.2, "init_radius_multiplier": 2.5},
        {"level": 3, "corridor_height_factor": 0.03, "init_radius_multiplier": 1.05},
        {"level": 1, "init_region_size": 1.5, "init_radius_multiplier": 1.8},
        {"level": 2, "init_region_size": 1.5, "allow_infeasible_init": True},
        {"level": 3, "optima_perturbation": (4.0, -3.0), "constraint_radius": 20.0},
    ],
)
def test_every_pixel_of_the_background(parameters):
    """Region and start area have their colours, except near edges, circles and the X."""
    config, size = Circle2DConfig(**parameters), 161
    shown = Circle2DView(config)
    image = shown.overlay(shown.background(size))
    assert (image.shape, image.dtype) == ((size, size, 3), np.uint8)
    points = centres(config, size)
    inside = config.region.contains(points)
    (left, low), (right, high) = config.start_rectangle
    x, y = points[..., 0], points[..., 1]
    start = (x >= left) & (x <= right) & (y >= low) & (y <= high)
    start &= ~inside | config.allow_infeasible_init
    from_optimum = np.linalg.norm(points - config.optima_perturbation, axis=-1)
    pixel, ring = 2 * config.arena / size, config.constraint_radius / 4
    on_circle = np.abs(from_optimum - ring * np.rint(from_optimum / ring)) < 1.8 * pixel
    near = near_an_edge(inside, 3) | near_an_edge(start) | on_circle
    sure = ~near & (from_optimum > 0.04 * size * pixel)
    expected = np.where(inside[..., None], canvas.REGION, canvas.FREE)
    expected[start] = view.START
    expected[start & inside] = view.START_IN_REGION
    assert sure.mean() > 0.45
    assert (start & sure).any()
    np.testing.assert_array_equal(image[sure], expected[sure])


@pytest.mark.parametrize("level", range(4))
def test_the_outline_lies_above_the_heat(level):
    """The region's edge, with the corridor's walls, and the X show even if heat covers all."""
    config = Circle2DConfig(level=level)
    shown, size = Circle2DView(config), 320
    heat = np.full((size, size, 3), 200, dtype=np.uint8)
    image = shown.overlay(heat)
    changed = (image != heat).any(axis=-1)
    points = centres(config, size)
    edge = near_an_edge(config.region.contains(points), 1)
    dark = image.max(axis=-1) < 170
    assert (dark & edge).sum() > 0.3 * edge.sum()  # the edge is two pixels wide
    around_x = np.hypot(points[..., 0], points[..., 1]) < 1.0
    assert not (changed & ~near_an_edge(config.region.contains(points), 3) & ~around_x).any()
    column, row = canvas.pixels(shown.extent, (-5.0, 2.5), size)  # the corridor's upper wall
    assert image[int(row) - 1 : int(row) + 2, int(column)].min() < 60
    assert (dark & around_x).any()


@pytest.mark.parametrize("name", ["Circle2D-2-v0", "Circle2DMuJoCo-2-v0"])
def test_the_view_of_an_environment(name):
    """It is found through wrappers and on the native vector environment; its positions are those
    of the agents."""
    env = gym.make(name, constraint_radius=3.0)
    shown = env.get_wrapper_attr("view")
    assert shown.extent == (-4.5, 4.5, -4.5, 4.5)
    assert shown.axes == ("x (world units)", "y (world units)")
    envs = gym.make_vec(name, 5, vectorization_mode="vector_entry_point", constraint_radius=3.0)
    assert envs.view == shown
    for go in (lambda: envs.reset(seed=0), lambda: envs.step(-np.ones((5, 2)))):
        observation, *_, info = go()
        found = envs.view.positions(observation, info)
        np.testing.assert_allclose(found, envs.position, atol=1e-6)
    places = shown.places(np.array([(-2.0, 0.0), (0.0, 2.5), (3.5, 0.0), (1.0, 0.5)]))
    assert places == ["corridor", "top cut-out", "right rim", "cost region"]


def ways(costs, positions=None, **parameters):
    """Return the way that led to each position, by default one in the corridor, at each cost."""
    config = Circle2DConfig(**parameters)
    at = np.array([(-5.0, 1.0)] * len(costs)) if positions is None else np.array(positions)
    return Circle2DView(config).ways(at * config.constraint_radius / 10, np.array(costs))


def test_ways_into_the_corridor_are_told_by_their_cost():
    """The way through the region has five cost steps on level 1, and two beside a cut-out."""
    assert ways([0.0, 4.0, 5.0, 10.0], level=1) == ["round", "round", "through", "through"]
    for level in (2, 3):
        assert ways([0.0, 1.0, 2.0], level=level) == ["round", "round", "through"]
    assert ways([0.0, 4.0, 5.0], level=1, constraint_radius=3.0) == ["round", "round", "through"]
    # Nobody passes a rigid region; contacts cost all the same.
    assert ways([0.0, 40.0], level=0) == ["round", "round"]
    elsewhere = [(-5.0, 1.0), (0.0, 5.0), (12.0, 0.0), (-12.0, 0.0)]
    assert ways([9.0] * 4, elsewhere, level=1) == ["through", "", "", ""]
    # The cost tells nothing if agents may start anywhere or pass without a cost.
    assert ways([0.0, 9.0], level=1, allow_infeasible_init=True) == ["", ""]
    assert ways([0.0, 9.0], level=1, init_region_size=2.5) == ["", ""]
    assert ways([0.0, 9.0], level=2, corridor_height_factor=0.9) == ["", ""]
