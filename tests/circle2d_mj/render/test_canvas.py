"""What is painted on the floor, pixel by pixel, against tests that share no code with it."""

from colorsys import rgb_to_hsv
from itertools import groupby

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from circle2d_mj import Circle2DConfig
from circle2d_mj.render import canvas

SIZE = 160
BLANK = np.full((SIZE, SIZE, 3), 252, dtype=np.uint8)
TASK = Circle2DConfig()  # R = 10 in an arena of ±15


def centres(config, size):
    """World coordinates of the pixels' centres: [size, size, 2], y falling from row to row."""
    steps = (np.arange(size) - (size - 1) / 2) * (2 * config.arena / size)
    return np.stack(np.meshgrid(steps, -steps), axis=-1)


def with_heat(positions, cells):
    """The heat of some positions on a blank picture, scaled to the most visits, and these."""
    counts = canvas.visits(TASK, positions, cells)
    most = int(counts.max())
    return canvas.with_counts(BLANK, counts, most), most


def near_an_edge(mask):
    """Where a pixel or one of its eight neighbours has another value."""
    padded = np.pad(mask, 1, mode="edge")
    shifts = [padded[i : i + len(mask), j : j + len(mask)] for i in range(3) for j in range(3)]
    return np.any(shifts, axis=0) & ~np.all(shifts, axis=0)


def painted_like(image, colour, tolerance=4):
    return (np.abs(image.astype(int) - colour) <= tolerance).all(axis=-1)


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
@pytest.mark.parametrize("size", [SIZE, 321])
def test_every_pixel_of_the_background(parameters, size):
    """Region and start area, but next to their edges, below circles and below the X."""
    config = Circle2DConfig(**parameters)
    image = canvas.background(config, size)
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
    sure = (
        ~on_circle
        & ~near_an_edge(inside)
        & ~near_an_edge(start)
        & (from_optimum > 0.04 * size * pixel)
    )
    expected = np.where(inside[..., None], canvas.REGION, canvas.FREE)
    expected[start] = canvas.START
    expected[start & inside] = canvas.START_IN_REGION
    assert sure.mean() > 0.5
    assert (start & sure).any()
    np.testing.assert_array_equal(image[sure], expected[sure])


def test_circles_of_equal_reward():
    """Every R/4 around the optimum; in an arena of 50 R as far apart as can be told apart."""
    config = Circle2DConfig(optima_perturbation=(3.0, 5.0))
    image = canvas.background(config, 640).astype(int)
    angles = np.deg2rad([10, 80, 100, 200, 260])
    for radius in np.arange(1, 13) * 1.25:  # circles, and halfway between them
        points = np.stack((3 + radius * np.cos(angles), 5 + radius * np.sin(angles)), axis=-1)
        points = points[np.abs(points).max(axis=1) < 14.9]
        columns, rows = ((points * (1, -1) + 15) * 640 / 30).astype(int).T
        around = zip(columns, rows, strict=True)
        darkest = [image[r - 1 : r + 2, c - 1 : c + 2].min() for c, r in around]
        flat = np.isin(darkest, (canvas.FREE[0], canvas.REGION[0], canvas.START[2]))
        assert flat.all() == (radius % 2.5 > 1), radius
    wide = canvas.background(Circle2DConfig(init_radius_multiplier=50.0), 640)
    assert painted_like(wide, canvas.FREE).mean() > 0.7


@pytest.mark.parametrize("optimum", [(0.0, 0.0), (4.0, -3.0), (-2.0, 7.5)])
def test_cross_on_the_optimum(optimum):
    config = Circle2DConfig(optima_perturbation=optimum)
    image = canvas.background(config, 640)
    rows, columns = np.nonzero((image < 100).all(axis=-1))
    expected = (np.array(optimum) * (1, -1) + 15) * 640 / 30
    assert np.abs((columns.mean() + 0.5, rows.mean() + 0.5) - expected).max() < 1
    assert 15 < np.ptp(columns) < 30
    assert 15 < np.ptp(rows) < 30
    slopes = (columns - columns.mean()) * (rows - rows.mean())
    assert (slopes > 20).any()
    assert (slopes < -20).any()


@pytest.mark.parametrize("radius", [1e-3, 1.0, 10.0])
@pytest.mark.parametrize("cells", [1, 7, 40, SIZE, 200])
def test_visits_against_numpys_histogram(radius, cells):
    config = Circle2DConfig(constraint_radius=radius)
    middle = 0.1 * radius, 0.2 * radius
    positions = np.random.default_rng(cells).normal(middle, 0.6 * radius, (20_000, 2))
    positions = positions[np.abs(positions).max(axis=1) < config.arena]
    edges = np.linspace(-config.arena, config.arena, cells + 1)
    x_by_y, _, _ = np.histogram2d(*positions.T, bins=(edges, edges))
    np.testing.assert_array_equal(canvas.visits(config, positions, cells), x_by_y.T[::-1])


def test_visits_at_the_edge_of_the_arena():
    """Corners and just beyond them, as a ball pressed against the edge is."""
    corners = np.array([(-15, 15), (15, 15), (-15, -15), (15, -15)])
    repeated = np.repeat(corners, [1, 2, 3, 4], axis=0)
    expected = np.zeros((30, 30))
    expected[[0, 0, -1, -1], [0, -1, 0, -1]] = [1, 2, 3, 4]
    for scale in (1.0, 1 - 1e-12, 1.02):
        np.testing.assert_array_equal(canvas.visits(TASK, repeated * scale, 30), expected)
    assert canvas.visits(TASK, repeated.astype(np.float32), 30).sum() == 10


@pytest.mark.parametrize(
    "positions",
    [
        np.zeros(2),
        np.zeros((4, 3)),
        np.zeros((2, 5, 2)),
        [[0.0, np.nan], [1, 1]],
        [[np.inf, 0.0]],
        [[0.0, 30.0]],
        [[-30.0, 0.0]],
        [[0.0, 0.0], [0.0, -1e9]],
    ],
)
def test_positions_that_are_none(positions):
    with pytest.raises(ValueError, match="positions must"):
        with_heat(positions, 40)


def test_heat_colours_the_visited_cells_alone():
    """One visit, three and nine, in cells of 8 pixels: the shares are 0, 1/2 and 1."""
    cell = 30 / 20
    top_left, right_below, bottom = (-15, 15), (15 - cell, 15 - cell), (0, -15 + cell)
    corners = np.array([top_left] + [right_below] * 3 + [bottom] * 9)
    positions = corners + np.array((0.3, -0.4)) * cell
    before = positions.copy()
    image, most = with_heat(positions, 20)
    assert most == 9
    expected = BLANK.copy()
    stops = {(0, 0): canvas.HEAT[0], (1, 19): canvas.HEAT[2], (19, 10): canvas.HEAT[4]}
    for (row, column), colour in stops.items():
        blended = np.array(colour) * canvas.OPACITY + 252 * (1 - canvas.OPACITY)
        expected[8 * row : 8 * row + 8, 8 * column : 8 * column + 8] = blended.astype(int)
    assert np.abs(image.astype(int) - expected).max() <= 1
    np.testing.assert_array_equal(image == BLANK, expected == BLANK)
    np.testing.assert_array_equal(positions, before)
    assert (BLANK == 252).all()


def test_a_common_scale_colours_by_its_own_most():
    """Nine visits are half of the way to 81, and what is beyond the most is as the most."""
    counts = np.array([[9, 200]])[[0, 0]]
    image = canvas.with_counts(np.full((2, 2, 3), 252, np.uint8), counts, 81)
    for column, colour in ((0, canvas.HEAT[2]), (1, canvas.HEAT[4])):
        blended = np.array(colour) * canvas.OPACITY + 252 * (1 - canvas.OPACITY)
        assert np.abs(image[:, column] - blended).max() <= 1


@pytest.mark.parametrize("cells", [37, 200])
def test_a_pixel_shows_the_cell_of_its_centre(cells):
    positions = np.random.default_rng(0).uniform(-15, 15, (cells * cells // 2, 2))
    image, _ = with_heat(positions, cells)
    edges = np.linspace(-15, 15, cells + 1)
    visited = np.histogram2d(*positions.T, bins=(edges, edges))[0] > 0
    x, y = (np.searchsorted(edges, centres(TASK, SIZE)[..., k]) - 1 for k in (0, 1))
    np.testing.assert_array_equal((image != BLANK).any(axis=-1), visited[x, y])


def test_heat_colours():
    dark_blue, *between, red = canvas.heat_colours(np.linspace(0, 1, 101)).astype(int)
    assert dark_blue[2] > 90
    assert dark_blue[:2].max() < 40
    assert red[0] > 180
    assert red[1:].max() < 60
    path = np.array([dark_blue, *between, red])
    hues = np.array([rgb_to_hsv(*colour)[0] for colour in path / 255])
    assert (np.diff(hues) <= 1e-9).all()  # from blue to red, never back
    assert len(np.unique(path, axis=0)) == 101
    assert np.abs(np.diff(path, axis=0)).max() < 15


@pytest.mark.parametrize(("times", "colour"), [(0, None), (1, 0), (2, -1), (5, -1)])
def test_cells_visited_equally_often(times, colour):
    """One visit each is dark blue; none leaves the picture as it is."""
    positions = np.tile([(1.0, 1.0), (-5.0, 8.0)], (times, 1))
    image, most = with_heat(positions, 20)
    assert most == times
    changed = image[(image != BLANK).any(axis=-1)].astype(int)
    assert len(changed) == (128 if times else 0)
    if times:
        blended = np.array(canvas.HEAT[colour]) * canvas.OPACITY + 252 * (1 - canvas.OPACITY)
        assert np.abs(changed - blended).max() <= 1


@settings(max_examples=200, deadline=None)
@given(st.lists(st.sampled_from([0.0, -1.0, 1.0, 2.5]), max_size=30))
def test_chains_against_groupby(costs):
    groups = groupby(range(len(costs)), key=lambda k: costs[k] > 0)
    expected = [(at[0], at[-1]) for unsafe, group in groups if unsafe for at in [list(group)]]
    assert canvas.chains(costs) == expected
    assert canvas.chains(np.array(costs)) == expected


def boxes(image):
    """Left, top, right and bottom of what is painted in the boxes' colour, one by one."""
    todo = set(zip(*np.nonzero(painted_like(image, canvas.BOX, 60)), strict=True))
    found = []
    while todo:
        part, edge = [], [todo.pop()]
        while edge:
            row, column = edge.pop()
            part.append((column, row))
            around = {(row + i, column + j) for i in (-1, 0, 1) for j in (-1, 0, 1)} & todo
            todo -= around
            edge += around
        found.append((*np.min(part, axis=0), *np.max(part, axis=0)))
    return sorted(found)


PATH = np.array([(-13 + 2.6 * k, 8 - 1.6 * k) for k in range(11)])


def test_without_boxes_states_that_cost_are_orange():
    """Each dot has the colour of the step that ended there; the start has none."""
    costs = np.isin(np.arange(10), [0, 4, 5, 9]).astype(float)
    image = canvas.with_trajectories(BLANK, TASK, [PATH], [costs], boxed=False)
    for column, row, cost in zip(
        *(((PATH * (1, -1) + 15) * SIZE / 30).T), [0, *costs], strict=True
    ):
        wanted = canvas.BOX if cost else canvas.DOT
        assert np.abs(image[int(row), int(column)].astype(int) - wanted).max() <= 60
    assert (np.abs(image[:, :, 0].astype(int) - canvas.BOX[0]) < 5).sum() < 4 * 9


@pytest.mark.parametrize(
    "unsafe", [[], [0], [9], [4], [0, 1, 2], [8, 9], [2, 3, 6], [0, 4, 5, 9], list(range(10))]
)
def test_a_box_around_each_chain(unsafe):
    """And around all its states alone: those that the steps with cost end in."""
    costs = np.isin(np.arange(10), unsafe).astype(float)
    image = canvas.with_trajectories(BLANK, TASK, [PATH], [costs])
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
    image = canvas.with_trajectories(large, TASK, [PATH, PATH * (1, -1)], np.zeros((2, 10)))
    dots = painted_like(image, canvas.DOT, 2)
    for points in (PATH, PATH * (1, -1)):
        for column, row in (points * (1, -1) + 15) * 4 * SIZE / 30:
            c, r = int(column), int(row)
            near = np.argwhere(dots[r - 7 : r + 8, c - 7 : c + 8])
            assert len(near) > 30
            assert np.abs(near.mean(axis=0) + 0.5 - (row - r + 7, column - c + 7)).max() < 1
    assert dots.sum() < 21 * 60  # one state is common to both
    between = (PATH[1:] + PATH[:-1]) / 2
    for column, row in ((between * (1, -1) + 15) * 4 * SIZE / 30).astype(int):
        assert painted_like(
            image[row - 1 : row + 2, column - 1 : column + 2], canvas.LINE, 60
        ).any()
    assert not boxes(image)
    assert (large == 252).all()


@pytest.mark.parametrize(
    ("paths", "costs", "message"),
    [
        ([PATH], [np.zeros(11)], "a path of 11 states needs 10 costs"),
        ([PATH], [np.zeros(9)], "a path of 11 states needs 10 costs"),
        ([PATH, PATH[:1]], [np.zeros(10), [1.0]], "a path of 1 states needs 0 costs"),
        ([PATH], [], "1 paths need as many rows of costs, got 0"),
        ([PATH[0]], [[0.0]], r"a path must have shape \[T \+ 1, 2\], got \[2\]"),
        ([np.zeros((0, 2))], [[]], r"a path must have shape \[T \+ 1, 2\], got \[0, 2\]"),
        ([[(0, 0), (np.nan, 1)]], [[0.0]], "finite"),
        ([[(0, 0), (1, 1)]], [[np.nan]], "finite"),
    ],
)
def test_paths_that_are_none(paths, costs, message):
    with pytest.raises(ValueError, match=message):
        canvas.with_trajectories(BLANK, TASK, paths, costs)


def test_nothing_drawn_is_nothing_changed():
    for size in (64, 101):
        background = canvas.background(TASK, size)
        np.testing.assert_array_equal(
            canvas.with_trajectories(background, TASK, [], []), background
        )
        np.testing.assert_array_equal(
            canvas.with_counts(background, np.zeros((20, 20), np.int64), 0), background
        )
    one_state = canvas.with_trajectories(BLANK, TASK, [[(3.0, 3.0)]], [[]])
    assert 1 <= (~painted_like(one_state, 252)).sum() < 20
