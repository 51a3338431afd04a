"""The MuJoCo scene: the contacts of its region against the cost region's formula; its XML."""

import mujoco
import numpy as np
import pytest
from mujoco.batch import Batch

from circle2d_mj import Circle2DConfig
from circle2d_mj.circle2d.scene import scene


class Contacts:
    """Tells which points touch the region, from MuJoCo's contacts, as the environment does."""

    def __init__(self, model, size):
        self._batch, self._size = Batch(model, size, 1), size
        self._qpos, self._ncon = self._batch.bind("qpos"), self._batch.bind("ncon")

    def __call__(self, points):
        found = []
        for part in points.reshape(-1, self._size, 2):
            self._qpos[:] = part
            self._batch.forward(stage=mujoco.mjtStage.mjSTAGE_POS)
            found.append(self._ncon > 0)
        return np.concatenate(found)


def is_near_the_edge(region, points, distance):
    """Return True for points within a distance of the region's edge: part of the ring around such
    a point lies on the other side."""
    angles = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    ring = points[:, None] + distance * np.stack((np.cos(angles), np.sin(angles)), axis=-1)
    return (region.contains(ring) != region.contains(points)[:, None]).any(axis=1)


OTHERS = [
    *({"level": level} for level in (1, 2, 3)),
    {"level": 1, "constraint_radius": 3.0, "corridor_height_factor": 0.1},
    {"level": 2, "constraint_radius": 1e-3, "corridor_height_factor": 1.0},
    {"level": 3, "constraint_radius": 1e6, "corridor_height_factor": 0.1},
    {"level": 3, "corridor_height_factor": 2.0, "init_radius_multiplier": 1.2},
    {"level": 3, "cutout_depth": 0.6},
]


@pytest.mark.parametrize("parameters", OTHERS)
def test_contacts_are_the_regions(parameters):
    """50 000 points all over the arena, and as many in a band around the rim. Of a million points
    all over the arena, at most 20 would be wrong in that band."""
    config = Circle2DConfig(**parameters)
    region, radius, size = config.region, config.constraint_radius, 50_000
    rng = np.random.default_rng(0)
    points = rng.uniform(-1.5 * radius, 1.5 * radius, (size, 2))
    band = 1e-3 * radius
    angle, distance = rng.uniform(0, 2 * np.pi, size), radius + rng.uniform(-band, band, size)
    at_rim = distance[:, None] * np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    contacts = Contacts(scene(config).compile(), 10_000)
    wrong = contacts(points) != region.contains(points)
    assert is_near_the_edge(region, points[wrong], band).all()
    wrong = contacts(at_rim) != region.contains(at_rim)
    in_the_band = 2 * np.pi * radius * 2 * band / (3 * radius) ** 2
    assert 0 < wrong.mean() * in_the_band * 1e6 <= 20


@pytest.mark.parametrize("radius", [1e-3, 3.0, 1e6])
def test_the_corridors_edges_are_exact_to_float32(radius):
    config = Circle2DConfig(constraint_radius=radius)
    rng = np.random.default_rng(0)
    u, off, side = rng.uniform(size=10_000), *rng.choice([-1, 1], size=(2, 10_000))
    walls = np.stack((-0.06 - 0.9 * u, side * (0.25 + 1e-5 * off)), axis=-1)
    end = np.stack((-0.05 + 1e-5 * off, side * 0.249 * u), axis=-1)
    points = np.concatenate((walls, end)) * radius
    contacts = Contacts(scene(config).compile(), 10_000)(points)
    np.testing.assert_array_equal(contacts, config.region.contains(points))
    assert 0.4 < contacts.mean() < 0.6


@pytest.mark.parametrize("level", range(4))
def test_a_scene_written_as_xml_is_read_as_the_same_region(level):
    """But for rounding: XML keeps six digits. test_parameters.py checks the movement."""
    spec = scene(Circle2DConfig(level=level, constraint_radius=1.0012345))
    model, read = spec.compile(), mujoco.MjModel.from_xml_string(spec.to_xml())
    names, read_names = ([m.geom(i).name for i in range(m.ngeom)] for m in (model, read))
    assert read_names == names
    points = np.random.default_rng(0).uniform(-1.5, 1.5, (5000, 2))
    touches = Contacts(model, 5000)(points)
    assert (touches != Contacts(read, 5000)(points)).sum() <= 1
    assert touches.any()
