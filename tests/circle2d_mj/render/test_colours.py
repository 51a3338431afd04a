"""The pictures' colours as people with the three common colour deficiencies see them."""

import numpy as np
import pytest
from seen import SEEN, lab

from circle2d_mj.render import canvas


@pytest.mark.parametrize("deficiency", SEEN)
def test_states_costs_and_ground_are_told_apart(deficiency):
    """Differences of 2.3 are just noticed side by side; small dots need many times that."""
    names = ("DOT", "BOX", "FREE", "REGION", "INK")
    at = [lab(getattr(canvas, name), deficiency) for name in names]
    apart = {(a, b): np.linalg.norm(at[i] - at[j]) for i, a in enumerate(names)
             for j, b in enumerate(names[:i])}  # fmt: skip
    assert min(apart.values()) > 20, apart
    assert apart["BOX", "DOT"] > 45


@pytest.mark.parametrize("deficiency", SEEN)
def test_more_visits_are_darker_for_everybody(deficiency):
    colours = canvas.heat_colours(np.linspace(0, 1, 33))
    lightness = lab(colours, deficiency)[:, 0]
    assert (np.diff(lightness) < 0).all()
    assert lightness[0] - lightness[-1] > 60
