"""The figures of a report, against positions, costs and records worked out here."""

import io

import numpy as np
import pytest
from PIL import Image

from agents.paper import introduction as example
from circle2d_mj import Circle2DConfig
from circle2d_mj.circle2d.envs import Circle2DEnv
from emcc import mcc


def image_of(figure):
    return np.asarray(Image.open(io.BytesIO(figure.content)).convert("RGB")).astype(int)


@pytest.mark.parametrize("name", example.ROUTES)
def test_scripted_episodes_are_those_of_the_environment(name):
    """The same actions, through the environment: the same positions and costs."""
    config = Circle2DConfig(level=1)
    path, costs = example.walk(config, example.ROUTES[name])
    env = Circle2DEnv(config=config)
    env.reset(seed=0)
    env.load_state_dict({**env.state_dict(), "position": path[:1].copy()})
    for k, action in enumerate(np.diff(path, axis=0) / 1.1):
        assert np.hypot(*action) <= 1 + 1e-9
        observation, _, _, _, info = env.step(action)
        np.testing.assert_allclose(observation * config.arena, path[k + 1], atol=1e-5)
        assert info["cost"] == costs[k]
    assert (len(costs), len(path)) == (50, 51)
    assert config.region.places(path[-1:]) == ["corridor"]
    (low, high) = config.start_rectangle
    assert (path[0] >= low).all()
    assert (path[0] <= high).all()


def test_equal_costs_and_different_chains():
    """As the paper's first figure: 10 cost steps each, in chains counted by hand."""
    costs = [example.walk(Circle2DConfig(), route).costs for route in example.ROUTES.values()]
    chains = [
        [len(part) for part in "".join(str(int(c)) for c in of).split("0") if part] for of in costs
    ]
    assert chains == [[10], [2, 3, 3, 2]]
    assert [mcc([of]) for of in costs] == [10 / 50, 3 / 50]
    _, words = example.two_trajectories(128)
    for part in ("chain 10, EMCC 0.20", "chain 3, EMCC 0.06", "cost rate (0.20) does"):
        assert part in words
