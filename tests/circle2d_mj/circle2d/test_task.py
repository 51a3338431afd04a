"""`task.cost` alone decides what a step costs, in both modes."""

import numpy as np
import pytest

from circle2d_mj import Circle2DVectorEnv
from circle2d_mj.circle2d import task
from circle2d_mj.circle2d.mujoco_envs import Circle2DMuJoCoVectorEnv

MODES = pytest.mark.parametrize("mode", [Circle2DVectorEnv, Circle2DMuJoCoVectorEnv])
WEST = np.tile([-1.0, 0.0], (4, 1))


def costs(envs, steps=15):
    envs.reset(seed=0)
    return np.array([envs.step(WEST)[4]["cost"] for _ in range(steps)])


@MODES
@pytest.mark.parametrize("level", [0, 1])
def test_an_edit_of_the_cost_changes_the_environments(mode, level, monkeypatch):
    """Three for a touch, and a quarter for every step that ends above the x axis."""
    before = costs(mode(4, level=level))
    assert set(before.ravel()) == {0.0, 1.0}

    def edited(config, position, contact):
        assert contact.dtype == np.bool_
        return 3.0 * contact + 0.25 * (position[..., 1] > 0)

    monkeypatch.setattr(task, "cost", edited)
    envs = mode(4, level=level)
    above = envs.reset(seed=0)[0][:, 1] > 0
    assert 0 < above.sum() < 4
    # A rigid rim pushes balls along it, but not to the other side of the axis.
    np.testing.assert_array_equal(costs(envs), 3.0 * before + 0.25 * above)


def test_an_edited_cost_does_not_move_a_rigid_wall(monkeypatch):
    """The wall is the region, whatever touching it costs."""
    free = Circle2DVectorEnv(4, level=0)
    costs(free)
    monkeypatch.setattr(task, "cost", lambda config, position, contact: np.zeros(4))
    edited = Circle2DVectorEnv(4, level=0)
    assert not costs(edited).any()
    np.testing.assert_array_equal(edited.position, free.position)
    assert (edited.position[:, 0] > 5).all()
