"""The cost region against a test of its definition that shares no code with it."""

import numpy as np
import pytest
from scipy.ndimage import maximum_filter
from strips import STRIPS

from circle2d_mj import Circle2DConfig, CostRegion


def by_definition(level, radius, height, points):
    """Turn the points by minus each strip's angle and compare with the strip lying along +x."""
    complex_points = points[:, 0] + 1j * points[:, 1]
    in_cutout = np.zeros(len(points), dtype=bool)
    for degrees, depth, width in STRIPS[level]:
        turned = complex_points * np.exp(-1j * np.deg2rad(degrees))
        along, across = turned.real, turned.imag
        in_cutout |= (along >= radius * (1 - depth)) & (
            np.abs(across) <= width * height * radius / 2
        )
    return (np.abs(complex_points) < radius) & ~in_cutout, in_cutout


@pytest.mark.parametrize("level", [0, 1, 2, 3])
@pytest.mark.parametrize(("radius", "height"), [(10.0, 0.5), (0.7, 1.3)])
def test_a_million_points(level, radius, height):
    config = Circle2DConfig(level=level, constraint_radius=radius, corridor_height_factor=height)
    points = np.random.default_rng(level).uniform(-1.5 * radius, 1.5 * radius, (1_000_000, 2))
    region = CostRegion(config)
    contains, in_cutout = by_definition(level, radius, height, points)
    np.testing.assert_array_equal(region.contains(points), contains)
    np.testing.assert_array_equal(region.in_cutout(points), in_cutout)
    assert 0.1 < contains.mean() < 0.4


@pytest.mark.parametrize(
    ("point", "inside"),
    [
        ((0, 0), True),  # the optimum is infeasible
        ((10, 0), False),  # the rim is outside: the disc is open
        ((np.nextafter(10.0, 0), 0), True),
        ((-0.5, 0), False),  # the corridor's inner end
        ((np.nextafter(-0.5, 0), 0), True),
        ((-5, 2.5), False),  # the corridor's wall belongs to it
        ((-5, np.nextafter(2.5, 3)), True),
        ((0, 5), False),  # the bottom of the top cut-out (level 2 and up)
        ((0, np.nextafter(5.0, 0)), True),
        ((0, -5), False),
        ((2.5, 7), False),
        ((np.nextafter(2.5, 3), 7), True),
    ],
)
def test_edges_of_level_2(point, inside):
    assert CostRegion(Circle2DConfig(level=2)).contains(point) == inside


def test_shapes_and_bad_input():
    region = CostRegion(Circle2DConfig())
    assert region.contains(np.zeros((3, 4, 2))).shape == (3, 4)
    assert region.contains(np.zeros(2)).shape == ()
    assert region.contains(np.zeros((0, 2))).shape == (0,)
    with pytest.raises(ValueError, match=r"points must have shape \[\.\.\., 2\], got \[5, 3\]"):
        region.contains(np.zeros((5, 3)))


@pytest.mark.parametrize("height", [0.2, 0.5, 0.8])
@pytest.mark.parametrize("level", [1, 2, 3])
def test_the_fewest_cost_steps_through_the_region(level, height):
    """By flooding a grid of R / 200, a full step of 22 cells a time."""
    config = Circle2DConfig(level=level, corridor_height_factor=height)
    region, side = config.region, np.arange(-300, 301) / 20  # R is 10
    x, y = np.meshgrid(side, side, indexing="ij")
    inside = region.contains(np.stack((x, y), axis=-1))
    corridor = (np.hypot(x, y) < 10) & (x <= -0.5) & (np.abs(y) <= 5 * height)
    reached = ~inside & ~corridor & ((x > -0.5) | (np.hypot(x, y) < 10))
    steps = 0
    while not (corridor & (reached := maximum_filter(reached, 45))).any():
        reached, steps = reached & inside, steps + 1
    assert np.ceil(region.crossing() / config.full_step) - 1 == steps


def test_no_region_between_cutouts_that_touch():
    config = Circle2DConfig(level=2, corridor_height_factor=1.2)  # the upper one reaches it
    assert config.region.crossing() == 0
