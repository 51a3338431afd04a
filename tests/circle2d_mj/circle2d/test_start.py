"""Start positions are uniform over the feasible part of the start area, and end."""

import hashlib

import numpy as np
import pytest
from scipy import stats

from circle2d_mj import Circle2DConfig, Circle2DVectorEnv
from circle2d_mj.circle2d import region
from circle2d_mj.circle2d.region import classify_cells
from circle2d_mj.core.streams import Streams


def sample(n=20_000, **parameters):
    config = Circle2DConfig(**parameters)
    streams = Streams(np.arange(n, dtype=np.uint64))
    return config, config.start_area.sample(streams, np.arange(n))


CONFIGS = [
    {},
    {"level": 3, "init_radius_multiplier": 1.05, "init_region_size": 1.9},
    {"level": 2, "constraint_radius": 3.0, "init_region_size": 2.6},
    {"init_radius_multiplier": 0.97},  # 4e-5 of the start area is feasible: two tiny corners
    {"init_region_size": 0.0},  # a line
]


@pytest.mark.parametrize("parameters", CONFIGS)
def test_feasible_and_inside_the_rectangle(parameters):
    config, points = sample(**parameters)
    (x0, y0), (x1, y1) = config.start_rectangle
    assert not config.region.contains(points).any()
    assert ((points >= [x0, y0]) & (points <= [x1, y1])).all()


@pytest.mark.parametrize("parameters", CONFIGS[:3])
def test_uniform_like_plain_rejection(parameters):
    """Two-sample Kolmogorov-Smirnov tests of x, y and x + y against naive rejection sampling."""
    config, points = sample(**parameters)
    rng = np.random.default_rng(1)
    naive = rng.uniform(*config.start_rectangle, size=(400_000, 2))
    naive = naive[~config.region.contains(naive)]
    for direction in ([1, 0], [0, 1], [1, 1]):
        assert stats.ks_2samp(points @ direction, naive @ direction).pvalue > 1e-3


def test_infeasible_starts_where_allowed():
    config, points = sample(allow_infeasible_init=True)
    share = config.region.contains(points).mean()
    (x0, y0), (x1, y1) = config.start_rectangle
    grid = np.stack(np.meshgrid(np.linspace(x0, x1, 1001), np.linspace(y0, y1, 1001)), axis=-1)
    assert share == pytest.approx(config.region.contains(grid).mean(), abs=0.01)


def test_a_sliver_is_found_and_nothing_is_refused():
    # The start area's corner (0.9683 R, 0.25 R) sticks out of the disc by 2e-5 R.
    _, points = sample(n=100, init_radius_multiplier=0.9683)
    assert (np.hypot(*points.T) >= 10).all()
    with pytest.raises(ValueError, match="no feasible start"):
        Circle2DConfig(init_radius_multiplier=0.9682)


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
    """Seeds mean the same in every release of v0; recorded from the first one."""
    envs = Circle2DVectorEnv(3, level=1)
    envs.reset(seed=0)
    recorded = [[12.131493842771306, -1.020089754856599], [14.481883460739482, 0.8080393588534207]]
    recorded += [[11.951850056593685, -0.007837696066417266]]
    np.testing.assert_allclose(envs.position, recorded, rtol=1e-14)


@pytest.mark.parametrize(
    ("parameters", "cells", "digest"),
    [
        (CONFIGS[0], 182, "33d58cf56455"),
        (CONFIGS[1], 6972, "0cc24c0dba44"),
        (CONFIGS[3], 1924, "f011e78fbf4b"),
        (EDGES | {"init_region_size": 1.01}, 45056, "bedd34a59252"),
    ],
)
def test_the_cells_of_version_v0(parameters, cells, digest):
    """To the bit, since starts are drawn in them; recorded when splits had no other end."""
    area = Circle2DConfig(**parameters).start_area
    assert len(area._corners) == cells
    kept = area._corners.tobytes() + area._size.tobytes()
    assert hashlib.sha1(kept).hexdigest().startswith(digest)
