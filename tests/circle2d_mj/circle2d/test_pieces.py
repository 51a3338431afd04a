"""The region's convex pieces, its depth and its grown form, each against something slower."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import KDTree
from strips import STRIPS

from circle2d_mj import Circle2DConfig
from circle2d_mj.circle2d.scene import OVERHANG, convex_pieces

R = 10.0
levels = pytest.mark.parametrize("level", [1, 2, 3])
shapes = given(st.integers(1, 3), st.floats(0.001, 2.0))


def region_of(level, height=0.5, radius=R):
    return Circle2DConfig(
        level=level, corridor_height_factor=height, constraint_radius=radius
    ).region


def area_of_region(level, height, lines=2000):
    """Of each chord of the unit disc, what no strip covers."""
    area = 0.0
    for y in (np.arange(lines) + 0.5) * 2 / lines - 1:
        end = math.sqrt(1 - y * y)
        reached = -end
        for low, high in sorted(span(y, angle, d, w * height) for angle, d, w in STRIPS[level]):
            area += max(0.0, min(low, end) - reached) * 2 / lines
            reached = min(max(reached, high), end)
        area += (end - reached) * 2 / lines
    return area


def span(y, degrees, depth, width):
    """From where to where a strip covers a line along x; turned by 17°, so that none lies along."""
    cos, sin = math.cos(math.radians(degrees + 17)), math.sin(math.radians(degrees + 17))
    low, high = -1.0, 1.0
    for a, b, bound in ((cos, sin, 1 - depth), (sin, -cos, -width / 2), (-sin, cos, -width / 2)):
        edge = (bound - b * y) / a  # of the half-plane a x + b y >= bound
        low, high = (max(low, edge), high) if a > 0 else (low, min(high, edge))
    return low, max(low, high)


def edges_of(piece):
    """Starts and directions of a polygon's edges, counter-clockwise."""
    return piece, np.roll(piece, -1, axis=0) - piece


def cross(u, v):
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]


def area_of(piece):
    start, along = edges_of(piece)
    return cross(start, start + along).sum() / 2


def inside(piece, points):
    """How far points are within a convex polygon; negative outside."""
    start, along = edges_of(piece)
    lengths = np.hypot(*along.T)
    keep = lengths > 1e-9
    start, along = start[keep], along[keep] / lengths[keep, None]
    return cross(along, points[:, None] - start).min(axis=1)


@pytest.mark.parametrize(("level", "pieces"), [(1, 3), (2, 7), (3, 11)])
def test_number_of_pieces(level, pieces):
    assert len(convex_pieces(region_of(level))) == pieces


@settings(max_examples=25)
@shapes
def test_pieces_are_convex_and_have_the_regions_area(level, height):
    pieces = convex_pieces(region_of(level, height))
    for piece in pieces:
        _, along = edges_of(piece)
        assert (cross(along, np.roll(along, -1, axis=0)) >= -1e-9 * R**2).all()
    # The disc's area is the polygon's; cut by strips, the two differ by parts of an edge's bulge.
    total = sum(area_of(piece) for piece in pieces) / R**2
    assert total == pytest.approx(area_of_region(level, height), abs=2e-5)


@settings(max_examples=25)
@shapes
def test_pieces_do_not_overlap_and_leave_no_gap(level, height):
    region = region_of(level, height)
    points = np.random.default_rng(0).uniform(-1.01 * R, 1.01 * R, (2000, 2))
    within = np.array([inside(piece, points) for piece in convex_pieces(region)])
    assert ((within > 1e-9).sum(axis=0) <= 1).all()
    rim = np.abs(np.hypot(*points.T) - R) <= OVERHANG * R
    contained = (within >= -1e-9).any(axis=0)
    np.testing.assert_array_equal(contained[~rim], region.contains(points)[~rim])


def test_the_polygon_keeps_within_its_overhang_of_the_circle():
    corners = np.unique(np.concatenate(convex_pieces(region_of(1))), axis=0)
    corners = corners[np.hypot(*corners.T) > 0.99 * R]
    corners = corners[np.argsort(np.arctan2(*corners.T))]
    assert R < np.hypot(*corners.T).max() <= R * (1 + OVERHANG)
    gaps = np.hypot(*np.diff(corners, axis=0).T)
    middles = (corners[1:] + corners[:-1])[gaps < 0.03 * R] / 2
    assert len(middles) > 200
    assert R > np.hypot(*middles.T).min() >= R * (1 - OVERHANG)


@levels
@pytest.mark.parametrize("radius", [10.0, 0.3])
def test_pieces_scale_with_the_radius(level, radius):
    for piece, scaled in zip(
        convex_pieces(region_of(level)),
        convex_pieces(region_of(level, radius=radius)),
        strict=True,
    ):
        np.testing.assert_allclose(scaled, piece * (radius / 10), rtol=1e-12, atol=1e-12 * radius)


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
    # A free node within a cell's diagonal of the nearest free point, even in a right corner of it.
    assert (nearest >= depth[contained] - 1e-9).all()
    assert (nearest <= depth[contained] + 2 * spacing).all()
    assert depth.max() > 0.1 * R


@levels
def test_grown_by_a_margin(level):
    """Nothing nearer than the margin is left out; what is added beyond lies at the corners."""
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
    """Where a strip's sides meet the rim."""
    turn = np.deg2rad(degrees)
    for side in (-1, 1):
        angle = turn + side * math.asin(width * 0.5 / 2)
        yield R * math.cos(angle), R * math.sin(angle)
