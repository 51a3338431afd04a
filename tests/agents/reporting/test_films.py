"""Films of several policies: what each picture shows, and that panels keep step."""

import numpy as np
import pytest

from agents.reporting import pictures as films
from agents.reporting.pictures import HELD, Panel
from agents.training.derive import Episode
from circle2d_mj import Circle2DConfig
from circle2d_mj.circle2d.view import Circle2DView

VIEW = Circle2DView(Circle2DConfig(level=1))
COSTS = [0, 1, 1, 0, 1]
RED = np.array(films.AGENT)


def episode(steps, costs=COSTS):
    """Along the x axis, one world unit a step."""
    path = np.stack((12.0 - np.arange(steps + 1), np.zeros(steps + 1)), axis=1)
    return Episode(path, np.array(costs[:steps], float))


def agent(picture):
    """Mean column of the pixels in the agent's colour."""
    return np.nonzero((picture == RED).all(axis=-1))[1].mean()


def test_a_film_shows_every_state_and_waits_for_the_longer_episode():
    panels = [Panel("a", VIEW, [episode(5), episode(2)]), Panel("b", VIEW, [episode(3)] * 2)]
    pictures = list(films.film(panels, 96))
    assert len(pictures) == films.pictures_of(panels) == (5 + 1 + HELD) + (3 + 1 + HELD)
    height, width, _ = pictures[0].shape
    assert height % 2 == width % 2 == 0
    assert {picture.shape for picture in pictures} == {pictures[0].shape}
    left = [agent(picture[:, : width // 2]) for picture in pictures[: 5 + 1]]
    right = [agent(picture[:, width // 2 :]) for picture in pictures[: 5 + 1]]
    step = 96 / 30  # pixels a world unit: the arena is 30 wide
    np.testing.assert_allclose(np.diff(left), -step, atol=0.8)
    np.testing.assert_allclose(np.diff(right), [*[-step] * 3, 0, 0], atol=0.8)


@pytest.mark.parametrize(
    ("steps", "words"),
    [
        (0, "episode 2, step 0: cost 0, longest streak 0"),
        (3, "episode 2, step 3: cost 2, longest streak 2"),
        (5, "episode 2, step 5: cost 3, longest streak 2"),
    ],
)
def test_the_running_cost_by_hand(steps, words):
    assert films._words(2, episode(5), steps) == words
