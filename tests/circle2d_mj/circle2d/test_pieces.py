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
    shape = {"corridor_height_factor": height, "constraint_radius": radius}
    return Circle2DConfig(level=level, **shape).region


def edges_of(piece):
    """Starts and directions of a polygon's edges, counter-clockwise."""
    return piece, np.roll(piece, -1, axis=0) - piece


def cross(u, v):
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]


def inside(piece, points):
    """How far points are within a convex polygon; negative outside."""
    start, along = edges_of(piece)
    lengths = np.hypot(*along.T)
    keep = lengths > 1e-9
    start, along = start[keep], along[keep] / lengths[keep, None]
    return cross(along, points[:, None] - start).min(axis=1)


@settings(max_examples=25)
@shapes
def test_pieces_are_convex_do_not_overlap_and_leave_no_gap(level, height):
    region = region_of(level, height)
    points = np.random.default_rng(0).uniform(-1.01 * R, 1.01 * R, (2000, 2))
    pieces = convex_pieces(region)
    for piece in pieces:
        _, along = edges_of(piece)
        assert (cross(along, np.roll(along, -1, axis=0)) >= -1e-9 * R**2).all()
    within = np.array([inside(piece, points) for piece in pieces])
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
