"""Heat, trajectories and outlines, pixel by pixel, against code that shares nothing with them."""

from itertools import groupby

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from circle2d_mj.core.view import histogram
from circle2d_mj.render import canvas

SIZE = 160
BLANK = np.full((SIZE, SIZE, 3), 252, dtype=np.uint8)
ARENA = (-15.0, 15.0, -15.0, 15.0)


def with_heat(positions, cells):
    """Paint the heat of positions on a blank picture; return it and the most visits of a cell."""
    counts = histogram(ARENA, positions, cells)
    most = int(counts.max())
    return canvas.with_counts(BLANK, counts, most), most


def painted_like(image, colour, tolerance=4):
    return (np.abs(image.astype(int) - colour) <= tolerance).all(axis=-1)


EXTENTS = [ARENA, (-1.5, 4.0, 0.6, 1.9), (0.0, 3e-3, -5e-3, -1e-3)]


@pytest.mark.parametrize("extent", EXTENTS)
@pytest.mark.parametrize("cells", [1, 7, 40, SIZE, 200])
def test_visits_against_numpys_histogram(extent, cells):
    left, right, bottom, top = extent
    positions = np.random.default_rng(cells).uniform((left, bottom), (right, top), (20_000, 2))
    edges = np.linspace(left, right, cells + 1), np.linspace(bottom, top, cells + 1)
    x_by_y, _, _ = np.histogram2d(*positions.T, bins=edges)
    np.testing.assert_array_equal(histogram(extent, positions, cells), x_by_y.T[::-1])


def test_visits_at_the_edge():
    """Corners count, and so do points 1.4 % beyond: a ball can press into the arena's soft edge."""
    corners = np.array([(-15, 15), (15, 15), (-15, -15), (15, -15)])
    repeated = np.repeat(corners, [1, 2, 3, 4], axis=0)
    expected = np.zeros((30, 30))
    expected[[0, 0, -1, -1], [0, -1, 0, -1]] = [1, 2, 3, 4]
    for scale in (1.0, 1 - 1e-12, 1.014):
        counts = histogram(ARENA, repeated * scale, 30)
        np.testing.assert_array_equal(counts, expected)
    assert histogram(ARENA, repeated.astype(np.float32), 30).sum() == 10
    outside = [(0.0, 16.0), (-16.0, 0.0), (0.0, -1e9), (1e300, 1.0)]
    assert histogram(ARENA, outside, 30).sum() == 0


@pytest.mark.parametrize("extent", EXTENTS)
def test_pixels_and_their_positions(extent):
    """Corners of the picture are known; the centre of each pixel is mapped there and back."""
    left, right, bottom, top = extent
    at = canvas.pixels(extent, [(left, top), (right, bottom), (left, bottom)], 50)
    np.testing.assert_allclose(at, [(0, 0), (50, 50), (0, 50)], atol=1e-9)
    there = canvas.pixels(extent, canvas.points_of_pixels(extent, 12), 12)
    columns, rows = np.meshgrid(np.arange(12) + 0.5, np.arange(12) + 0.5)
    np.testing.assert_allclose(there, np.stack((columns, rows), axis=-1), atol=1e-9)


@pytest.mark.parametrize("positions", [np.zeros(2), np.zeros((4, 3)), [[np.inf, 0.0]]])
def test_bad_positions_are_named(positions):
    with pytest.raises(ValueError, match="positions must"):
        histogram(ARENA, positions, 40)


def test_heat_colours_only_visited_cells():
    """One, three and nine visits, in cells of 8 pixels, lie at 0, 1/2 and 1 of the colours: the
    scale is logarithmic."""
    cell = 30 / 20
    top_left, right_below, bottom = (-15, 15), (15 - cell, 15 - cell), (0, -15 + cell)
    corners = np.array([top_left] + [right_below] * 3 + [bottom] * 9)
    positions = corners + np.array((0.3, -0.4)) * cell
    before = positions.copy()
    image, most = with_heat(positions, 20)
    assert most == 9
    expected = BLANK.copy()
    stops = {(0, 0): canvas.HEAT[0], (1, 19): canvas.HEAT[8], (19, 10): canvas.HEAT[-1]}
    for (row, column), colour in stops.items():
        expected[8 * row : 8 * row + 8, 8 * column : 8 * column + 8] = colour
    np.testing.assert_array_equal(image, expected)
    np.testing.assert_array_equal(positions, before)
    assert (BLANK == 252).all()


def test_a_given_most_sets_the_scale():
    """Nine visits lie half way to 81 on the logarithmic scale; more than the most look the same."""
    counts = np.array([[9, 200]])[[0, 0]]
    image = canvas.with_counts(np.full((2, 2, 3), 252, np.uint8), counts, 81)
    np.testing.assert_array_equal(image[0], [canvas.HEAT[8], canvas.HEAT[-1]])


@pytest.mark.parametrize("cells", [37, 200])
def test_a_pixel_shows_the_cell_of_its_centre(cells):
    positions = np.random.default_rng(0).uniform(-15, 15, (cells * cells // 2, 2))
    image, _ = with_heat(positions, cells)
    edges = np.linspace(-15, 15, cells + 1)
    visited = np.histogram2d(*positions.T, bins=(edges, edges))[0] > 0
    centres = (np.arange(SIZE) + 0.5) * 30 / SIZE - 15
    x, y = np.meshgrid(*[np.searchsorted(edges, at) - 1 for at in (centres, -centres)])
    np.testing.assert_array_equal((image != BLANK).any(axis=-1), visited[x, y])


@given(st.lists(st.sampled_from([0.0, -1.0, 1.0, 2.5]), max_size=30))
def test_chains_against_groupby(costs):
    groups = groupby(range(len(costs)), key=lambda k: costs[k] > 0)
    expected = [(at[0], at[-1]) for unsafe, group in groups if unsafe for at in [list(group)]]
    assert canvas.chains(costs) == expected
    assert canvas.chains(np.array(costs)) == expected


def boxes(image):
    """Return the left, top, right and bottom of each box in a picture."""
    parts, _ = ndimage.label(painted_like(image, canvas.BOX, 60), np.ones((3, 3)))
    found = ndimage.find_objects(parts)
    return sorted((c.start, r.start, c.stop - 1, r.stop - 1) for r, c in found)


PATH = np.array([(-13 + 2.6 * k, 8 - 1.6 * k) for k in range(11)])


def test_without_boxes_states_that_cost_have_the_colour_of_boxes():
    """Each dot has the colour of the step that ended there; the start has none."""
    costs = np.isin(np.arange(10), [0, 4, 5, 9]).astype(float)
    image = canvas.with_trajectories(BLANK, ARENA, [PATH], [costs], boxed=False)
    places = (PATH * (1, -1) + 15) * SIZE / 30
    for (column, row), cost in zip(places, [0, *costs], strict=True):
        wanted = canvas.BOX if cost else canvas.DOT
        assert np.abs(image[int(row), int(column)].astype(int) - wanted).max() <= 60
    assert (np.abs(image[:, :, 0].astype(int) - canvas.BOX[0]) < 5).sum() < 4 * 9


@pytest.mark.parametrize("unsafe", [[], [4], [0, 1, 2], [2, 3, 6], [0, 4, 5, 9], list(range(10))])
def test_a_box_around_each_chain(unsafe):
    """A box surrounds the states in which the steps of a chain end, and no others."""
    costs = np.isin(np.arange(10), unsafe).astype(float)
    image = canvas.with_trajectories(BLANK, ARENA, [PATH], [costs])
    at = (PATH * (1, -1) + 15) * SIZE / 30
    groups = groupby(range(10), key=lambda k: k in unsafe)
    members = [np.array(list(group)) + 1 for inside, group in groups if inside]
    expected = sorted((*at[m].min(axis=0) - 2.2, *at[m].max(axis=0) + 2.2) for m in members)
    found = boxes(image)
    assert len(found) == len(expected)
    for corners, wanted in zip(found, expected, strict=True):
        assert np.abs(np.array(corners) + 0.5 - wanted).max() < 1.2, (corners, wanted)


def test_a_dot_at_each_state():
    large = np.full((4 * SIZE, 4 * SIZE, 3), 252, dtype=np.uint8)
    image = canvas.with_trajectories(large, ARENA, [PATH, PATH * (1, -1)], np.zeros((2, 10)))
    dots = painted_like(image, canvas.DOT, 2)
    for points in (PATH, PATH * (1, -1)):
        for column, row in (points * (1, -1) + 15) * 4 * SIZE / 30:
            c, r = int(column), int(row)
            near = np.argwhere(dots[r - 7 : r + 8, c - 7 : c + 8])
            assert len(near) > 30
            assert np.abs(near.mean(axis=0) + 0.5 - (row - r + 7, column - c + 7)).max() < 1
    assert dots.sum() < 21 * 60  # both paths share one state
    between = (PATH[1:] + PATH[:-1]) / 2
    for column, row in ((between * (1, -1) + 15) * 4 * SIZE / 30).astype(int):
        around = image[row - 1 : row + 2, column - 1 : column + 2]
        assert painted_like(around, canvas.LINE, 60).any()
    assert not boxes(image)
    assert (large == 252).all()


@pytest.mark.parametrize(
    ("paths", "costs", "message"),
    [
        ([PATH], [np.zeros(11)], r"got \[11, 2\] and"),
        ([PATH, PATH[:1]], [np.zeros(10), [1.0]], r"got \[1, 2\] and \[1\]"),
        ([PATH], [], "1 paths need as many rows of costs, got 0"),
        ([np.zeros((0, 2))], [[]], r"got \[0, 2\] and \[0\]"),
        ([[(0, 0), (np.nan, 1)]], [[0.0]], "finite"),
        ([[(0, 0), (1, 1)]], [[np.nan]], "finite"),
    ],
)
def test_bad_paths_are_named(paths, costs, message):
    with pytest.raises(ValueError, match=message):
        canvas.with_trajectories(BLANK, ARENA, paths, costs)


def test_an_outline_follows_the_edge_of_an_area():
    """For a half-plane: dark along its edge, light beside it, nothing at the picture's border."""
    inside = np.zeros((2 * SIZE, 2 * SIZE), dtype=bool)
    inside[:, 100:] = True  # from pixel 50 on
    grey = np.full((SIZE, SIZE, 3), 128, dtype=np.uint8)
    image = canvas.with_outline(grey, inside)
    assert (image == image[:1]).all()
    columns = image[0, :, 0].astype(int)
    assert columns[50] == 20
    assert 100 < columns[51] < 160  # half of it
    assert columns[49] > 180
    assert (columns[[*range(49), *range(52, SIZE)]] == 128).all()
    assert (grey == 128).all()


def test_one_hot_cell_does_not_flatten_the_scale():
    """The most is the count that 99 % of the visited cells of all maps do not exceed."""
    one, two = np.zeros((20, 20), np.int64), np.zeros((20, 20), np.int64)
    one.flat[:100], two.flat[:99] = np.arange(1, 101), np.arange(101, 200)
    two.flat[399] = 10**6
    assert canvas.most_visits([one, two]) == 199  # 198 of 200 are at most 198
    assert canvas.most_visits([one]) == 100
    assert canvas.most_visits([one, two], quantile=1.0) == 10**6
    assert canvas.most_visits([one * 0]) == canvas.most_visits([]) == 1


@pytest.mark.parametrize("size", [100, 400, 640])
def test_a_regions_edge_does_not_strike_through_the_number_of_a_tick(size):
    """In the row of a tick, only the tick itself is drawn; its number lies above."""
    blank = np.full((size, size, 3), canvas.FREE, np.uint8)
    shown = canvas.with_ticks(blank, (0.0, 1.0, 0.0, 1.0), ("", ""), ((0.9,), (0.25, 0.5)))
    inked = (shown != canvas.FREE).any(-1)
    for y in (0.25, 0.5):
        row = int(canvas.pixels((0.0, 1.0, 0.0, 1.0), [(0.0, y)], size)[0, 1])
        assert inked[row, : size // 60].any()
        assert not inked[row, size // 40 :].any()
        assert inked[row - size // 20 : row, size // 40 :].any()
