"""The cost region against its definition; start positions against rejection sampling; the
region's convex pieces, depth and grown form against slower computations."""

import hashlib
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from scipy.ndimage import maximum_filter
from scipy.spatial import KDTree
from strips import STRIPS

from circle2d_mj import Circle2DConfig, Circle2DVectorEnv, CostRegion
from circle2d_mj.circle2d import region
from circle2d_mj.circle2d.region import classify_cells
from circle2d_mj.circle2d.scene import OVERHANG, convex_pieces
from circle2d_mj.core.streams import Streams


def by_definition(level, radius, height, points, deeper=1.0):
    """Return (in the region, in a cut-out): points are turned until each strip lies along +x.

    deeper: factor on the published depth of all cut-outs except the corridor.
    """
    complex_points = points[:, 0] + 1j * points[:, 1]
    in_cutout = np.zeros(len(points), dtype=bool)
    for degrees, published, width in STRIPS[level]:
        depth = published * (1.0 if degrees == 180 else deeper)
        turned = complex_points * np.exp(-1j * np.deg2rad(degrees))
        along, across = turned.real, turned.imag
        in_cutout |= (along >= radius * (1 - depth)) & (
            np.abs(across) <= width * height * radius / 2
        )
    return (np.abs(complex_points) < radius) & ~in_cutout, in_cutout


SHAPES = [(10.0, 0.5, 0.5), (0.7, 1.3, 0.5)]  # radius, height and depth
SHAPES += [(10.0, 0.5, 0.55), (10.0, 0.5, 0.6), (10.0, 2.0, 0.8), (10.0, 0.3, 0.01)]


@pytest.mark.parametrize("level", [0, 1, 2, 3])
@pytest.mark.parametrize(("radius", "height", "depth"), SHAPES)
def test_the_region_is_that_of_the_definition(level, radius, height, depth):
    """At points all over the arena; the depth concerns only the cut-outs of levels 2 and 3."""
    shape = {"level": level, "constraint_radius": radius, "corridor_height_factor": height}
    region = CostRegion(Circle2DConfig(**shape, cutout_depth=depth))
    points = np.random.default_rng(level).uniform(-1.5 * radius, 1.5 * radius, (100_000, 2))
    contains, in_cutout = by_definition(level, radius, height, points, depth / 0.5)
    np.testing.assert_array_equal(region.contains(points), contains)
    np.testing.assert_array_equal(region.in_cutout(points), in_cutout)
    assert 0.1 < contains.mean() < 0.4 or depth == 0.8
    published = Circle2DConfig(**shape).region
    assert (region.cutouts == published.cutouts) is (level < 2 or depth == 0.5)


def test_the_published_depth_is_the_default_bit_for_bit():
    for radius in (10.0, 0.7, 1e6 / 3):
        region = Circle2DConfig(level=3, constraint_radius=radius, cutout_depth=0.5).region
        assert [cut.inner for cut in region.cutouts] == [0.05 * radius, 0.5 * radius, 0.7 * radius]
        assert Circle2DConfig(level=3, constraint_radius=radius).region.cutouts == region.cutouts


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
    """Against flooding a grid with cells of R / 200, a full step of 22 cells at a time."""
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


def test_touching_cutouts_leave_no_region_to_cross():
    # The upper cut-out reaches the corridor.
    config = Circle2DConfig(level=2, corridor_height_factor=1.2)
    assert config.region.crossing() == 0


AREAS = [
    {},
    {"level": 3, "init_radius_multiplier": 1.05, "init_region_size": 1.9},
    {"level": 2, "constraint_radius": 3.0, "init_region_size": 2.6},
    {"init_radius_multiplier": 0.97},  # 4e-5 of the start area is feasible: two tiny corners
    {"init_region_size": 0.0},  # a line
    {"init_region_size": 1.5, "allow_infeasible_init": True},
]


@pytest.mark.parametrize("parameters", AREAS)
def test_starts_are_uniform_over_what_is_feasible(parameters):
    """Against rejection sampling, by two-sample Kolmogorov-Smirnov tests of x, y and x + y."""
    config, n = Circle2DConfig(**parameters), 20_000
    points = config.start_area.sample(Streams(np.arange(n, dtype=np.uint64)), np.arange(n))
    low, high = np.array(config.start_rectangle)
    assert config.region.contains(points).any() == config.allow_infeasible_init
    assert ((points >= low) & (points <= high)).all()
    naive = np.random.default_rng(1).uniform(low, high, size=(400_000, 2))
    naive = naive[~config.region.contains(naive) | config.allow_infeasible_init]
    for direction in ([1, 0], [0, 1], [1, 1]):
        assert stats.ks_2samp(points @ direction, naive @ direction).pvalue > 1e-3


EDGES = {"level": 2, "corridor_height_factor": 2.0, "init_radius_multiplier": 0.6}
"""The top and bottom cut-outs begin where a start area of size 1 ends."""


@pytest.mark.parametrize("size", [1.0, 1.000001])
def test_an_edge_that_touches_a_cutout_is_refused_before_memory_is_full(monkeypatch, size):
    def counted(region, low, cell):
        assert len(low) <= 2**20
        return classify_cells(region, low, cell)

    monkeypatch.setattr(region, "classify_cells", counted)
    with pytest.raises(ValueError, match="no feasible start"):
        Circle2DConfig(**EDGES, init_region_size=size)


def test_the_starts_of_version_v0():
    """Recorded from the first release of v0: seeds mean the same in all its releases."""
    envs = Circle2DVectorEnv(3, level=1)
    envs.reset(seed=0)
    recorded = [[12.131493842771306, -1.020089754856599], [14.481883460739482, 0.8080393588534207]]
    recorded += [[11.951850056593685, -0.007837696066417266]]
    np.testing.assert_allclose(envs.position, recorded, rtol=1e-14)


@pytest.mark.parametrize(
    ("parameters", "cells", "digest"),
    [
        (AREAS[0], 182, "33d58cf56455"),
        (AREAS[1], 6972, "0cc24c0dba44"),
        (AREAS[3], 1924, "f011e78fbf4b"),
        (EDGES | {"init_region_size": 1.01}, 45056, "bedd34a59252"),
    ],
)
def test_the_cells_of_version_v0(parameters, cells, digest):
    """Bit for bit, since starts are drawn in these cells; recorded before the number of cells had a
    limit."""
    area = Circle2DConfig(**parameters).start_area
    assert len(area._corners) == cells
    kept = area._corners.tobytes() + area._size.tobytes()
    assert hashlib.sha1(kept).hexdigest().startswith(digest)


R = 10.0


def region_of(level, height=0.5):
    return Circle2DConfig(level=level, corridor_height_factor=height).region


def cross(u, v):
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]


def inside(piece, points):
    """Return the distance of points to the edge of a convex polygon; it is negative outside."""
    along = np.roll(piece, -1, axis=0) - piece
    lengths = np.hypot(*along.T)
    keep = lengths > 1e-9
    along = along[keep] / lengths[keep, None]
    return cross(along, points[:, None] - piece[keep]).min(axis=1)


@settings(max_examples=25)
@given(st.integers(1, 3), st.floats(0.001, 2.0))
def test_pieces_are_convex_do_not_overlap_and_leave_no_gap(level, height):
    region = region_of(level, height)
    points = np.random.default_rng(0).uniform(-1.01 * R, 1.01 * R, (2000, 2))
    pieces = convex_pieces(region)
    for piece in pieces:
        along = np.roll(piece, -1, axis=0) - piece
        assert (cross(along, np.roll(along, -1, axis=0)) >= -1e-9 * R**2).all()
    within = np.array([inside(piece, points) for piece in pieces])
    assert ((within > 1e-9).sum(axis=0) <= 1).all()
    rim = np.abs(np.hypot(*points.T) - R) <= OVERHANG * R
    contained = (within >= -1e-9).any(axis=0)
    np.testing.assert_array_equal(contained[~rim], region.contains(points)[~rim])


def grid(reach, spacing):
    ticks = np.arange(-reach, reach, spacing)
    return np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2)


@pytest.mark.parametrize(("level", "height"), [(1, 0.5), (2, 0.5), (3, 0.5), (3, 1.1), (3, 2.0)])
def test_depth_is_the_distance_to_free_space(level, height):
    region, spacing = region_of(level, height), 0.03
    points = np.random.default_rng(level).uniform(-R, R, (20_000, 2))
    depth, contained = region.depth(points), region.contains(points)
    assert (depth[~contained] == 0).all()
    assert (depth[contained] > 0).all()
    nodes = grid(1.1 * R, spacing)
    nearest, _ = KDTree(nodes[~region.contains(nodes)]).query(points[contained])
    # The nearest free node is at most two cells beyond the nearest free point, even in a corner.
    assert (nearest >= depth[contained] - 1e-9).all()
    assert (nearest <= depth[contained] + 2 * spacing).all()
    assert depth.max() > 0.1 * R


@pytest.mark.parametrize("level", [1, 2, 3])
def test_grown_by_a_margin(level):
    """All points within the margin are in; points beyond it are in only near the corners."""
    region, spacing, margin = region_of(level), 0.03, 0.6
    grown = region.grown(margin)
    points = np.random.default_rng(level).uniform(-1.2 * R, 1.2 * R, (20_000, 2))
    nodes = grid(1.1 * R, spacing)
    taken = nodes[region.contains(nodes)]
    distance, nearest = KDTree(taken).query(points)
    contained = grown.contains(points)
    assert contained[distance < margin - spacing].all()
    added = contained & (distance > margin + spacing)
    corners = np.array([corner for strip in STRIPS[level] for corner in rim_corners(*strip)])
    to_corner = KDTree(corners).query(taken[nearest[added]])[0]
    assert (to_corner < 0.1).all()
    assert (distance[added] < 2 * margin).all()


def rim_corners(degrees, _, width):
    """Yield the points where a strip's sides meet the rim."""
    turn = np.deg2rad(degrees)
    for side in (-1, 1):
        angle = turn + side * math.asin(width * 0.5 / 2)
        yield R * math.cos(angle), R * math.sin(angle)
