"""Lines of figures, told apart with any colour vision, and without colour."""

import itertools

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from seen import SEEN, lab

from agents.algorithms import ALGORITHMS
from agents.paper.presets import PAPER_ALGORITHMS
from agents.reporting.figures import COLOURS, styles
from agents.training.config import TrainConfig


def config(name):
    return TrainConfig(name, ("Circle2D-1-v0",), (0,), 1000, ALGORITHMS[name].config())


@pytest.mark.parametrize("deficiency", SEEN)
def test_colours_are_told_apart(deficiency):
    """Differences of 2.3 are just noticed side by side; thin lines need several times that."""
    seen = {of: lab(255 * np.array(to_rgb(of)), deficiency) for of in (*COLOURS, "#ffffff")}
    apart = {(a, b): np.linalg.norm(seen[a] - seen[b]) for a, b in itertools.combinations(seen, 2)}
    assert min(apart.values()) > 15, apart


def test_every_algorithm_has_a_line_of_its_own_and_those_of_the_paper_without_colour_too():
    found = styles([config(name) for name in ALGORITHMS])
    assert len({(of.colour, of.dash) for of in found}) == len(ALGORITHMS)
    alone = styles([config(name) for name in PAPER_ALGORITHMS])
    assert len({of.dash for of in alone}) == len({of.marker for of in alone}) == len(alone)
