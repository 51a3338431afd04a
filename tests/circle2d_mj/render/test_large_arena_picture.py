"""A large arena is drawn whole, though MuJoCo compiles no camera that is wide enough."""

import numpy as np

from circle2d_mj import Circle2DConfig
from circle2d_mj.render.renderer import Renderer


def test_pictures_are_the_same_at_any_radius(opengl):
    def picture(radius):
        with Renderer(Circle2DConfig(constraint_radius=radius), size=64) as renderer:
            return renderer.frame([0.3 * radius, -0.4 * radius])

    usual = picture(10.0)
    for radius in (100.0, 1e5):
        different = np.abs(picture(radius).astype(int) - usual).max(axis=-1) > 8
        assert different.mean() < 0.01
