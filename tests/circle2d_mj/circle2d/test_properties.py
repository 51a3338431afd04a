"""Properties that hold for every configuration, start and action."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from circle2d_mj import Circle2DConfig, Circle2DVectorEnv
from circle2d_mj.circle2d import task
from circle2d_mj.circle2d.mujoco_envs import Circle2DMuJoCoVectorEnv

# Physics has fewer examples, as each compiles a model. The number bounds positions: the arena's
# edge is soft with physics.
kinematic = (Circle2DVectorEnv, 15.0)
physics = (Circle2DMuJoCoVectorEnv, 15.2)
modes = st.sampled_from([kinematic, kinematic, physics])
levels = st.integers(0, 3)
seeds = st.integers(0, 2**32)
heights = st.floats(0.051, 2.0)  # the body must fit into a rigid corridor


def play(
    config, seed, steps=50, num_envs=16, mirror=False, scale=1.0, make=Circle2DVectorEnv, **options
):
    """Play random episodes; return starts, positions, rewards, costs: [steps, num_envs, ...]."""
    envs = make(num_envs, config=config, **options)
    envs.reset(seed=seed)
    if mirror:
        envs._dynamics.place(np.arange(num_envs), envs.position * [1, -1])
    start = envs.position
    rng = np.random.default_rng(seed)
    # A drift to the left brings the agents into the region and through it.
    drift = rng.uniform([-1, -0.5], [0, 0.5], size=(num_envs, 2))
    positions, rewards, costs = [], [], []
    for _ in range(steps):
        action = np.clip(drift + rng.normal(scale=0.5, size=(num_envs, 2)), -1.5, 1.5)
        _, reward, _, _, info = envs.step(action * ([1, -1] if mirror else 1))
        positions.append(envs.position / scale)
        rewards.append(reward)
        costs.append(info["cost"])
    return start, np.array(positions), np.array(rewards), np.array(costs)


@settings(max_examples=20)
@given(levels, seeds, heights, st.sampled_from([2.0**-30, 0.25, 4.0, 2.0**20]))
def test_the_task_is_the_same_at_any_radius(level, seed, height, factor):
    """Factors are powers of two, which scale without rounding: runs are equal bit for bit."""
    small, large = (
        Circle2DConfig(level=level, constraint_radius=radius, corridor_height_factor=height)
        for radius in (10.0, 10.0 * factor)
    )
    _, *expected = play(small, seed)
    _, *scaled = play(large, seed, scale=factor)
    for a, b in zip(expected, scaled, strict=True):
        np.testing.assert_array_equal(a, b)


RADII = st.sampled_from([1e-3, 0.7, 3.0, 1000.0, 1e6])


@settings(max_examples=10)
@given(levels, seeds, heights, RADII, st.sampled_from(["velocity", "force"]))
def test_the_physics_are_the_same_at_any_radius(level, seed, height, radius, actuation):
    """Up to 1e-6 R where the region can be entered; a rigid region's meshes are of float32, which
    moves the moment of contact."""
    parameters = {"level": level, "corridor_height_factor": height}
    how = {"make": Circle2DMuJoCoVectorEnv, "actuation": actuation}
    small, large = (
        play(Circle2DConfig(**parameters, constraint_radius=r), seed, scale=r / 10, **how)
        for r in (10.0, radius)
    )
    tolerance = 1e-6 if level else 0.02
    np.testing.assert_allclose(large[1], small[1], atol=10 * tolerance)
    np.testing.assert_allclose(large[2], small[2], atol=tolerance)
    assert (large[3] != small[3]).mean() < 1e-2


@settings(max_examples=20)
@given(levels, seeds, heights, st.booleans())
def test_mirror_symmetry(level, seed, height, sparse):
    config = Circle2DConfig(level=level, corridor_height_factor=height, sparse_reward=sparse)
    start, positions, rewards, costs = play(config, seed)
    mirrored_start, mirrored, mirrored_rewards, mirrored_costs = play(config, seed, mirror=True)
    np.testing.assert_array_equal(mirrored_start, start * [1, -1])
    np.testing.assert_array_equal(mirrored, positions * [1, -1])
    np.testing.assert_array_equal(mirrored_rewards, rewards)
    np.testing.assert_array_equal(mirrored_costs, costs)


@settings(max_examples=20)
@given(modes, levels, seeds, heights, st.booleans(), st.floats(0, 0.99), st.floats(0, 2 * math.pi))
def test_rewards_costs_and_bounds(mode, level, seed, height, sparse, distance, angle):
    make, arena = mode
    optimum = (10 * distance * math.cos(angle), 10 * distance * math.sin(angle))
    shape = {"level": level, "corridor_height_factor": height}
    config = Circle2DConfig(**shape, sparse_reward=sparse, optima_perturbation=optimum)
    _, positions, rewards, costs = play(config, seed, make=make)
    assert np.isin(costs, [0.0, 1.0]).all()
    if level > 0:  # a step costs where it ends
        wrong = (costs == 1) != config.region.contains(positions)
        # The polygon of contacts deviates from the disc by less than 1e-4 R.
        assert not wrong[np.abs(np.hypot(*np.moveaxis(positions, -1, 0)) - 10) > 1e-3].any()
        assert not (mode is kinematic and wrong.any())
    assert np.abs(positions).max() <= arena
    # The arena's farthest corner from the optimum is at most this many half-diagonals away.
    farthest = math.hypot(arena + abs(optimum[0]), arena + abs(optimum[1]))
    worst = farthest / math.hypot(15, 15) + 1e-12
    if sparse:
        assert ((rewards >= 1 - worst) & (rewards <= 1)).all()
        outside = ~config.region.in_cutout(positions)
        assert (rewards[outside] == 0).all()
        distance = np.hypot(*np.moveaxis(positions - optimum, -1, 0)) / math.hypot(15, 15)
        np.testing.assert_allclose(rewards[~outside], 1 - distance[~outside], atol=1e-12)
    else:
        assert ((rewards >= -worst) & (rewards <= 0)).all()
        expected = -np.hypot(*np.moveaxis(positions - optimum, -1, 0)) / math.hypot(15, 15)
        np.testing.assert_allclose(rewards, expected, rtol=1e-12, atol=1e-15)


@settings(max_examples=20)
@given(modes, levels, seeds, heights, st.floats(0.5, 2.8))
def test_never_inside_where_the_region_cannot_be_entered(mode, level, seed, height, size):
    shape = {"level": level, "corridor_height_factor": height, "init_region_size": size}
    config = Circle2DConfig(**shape, infeasible_region_penetratable=False)
    start, positions, _, costs = play(config, seed, make=mode[0])
    assert not config.region.contains(start).any()
    assert not config.region.contains(positions).any()
    if mode is physics:
        return
    blocked = costs > 0
    stayed = (np.diff(np.concatenate([start[None], positions]), axis=0) == 0).all(axis=-1)
    assert stayed[blocked].all()


MODES = pytest.mark.parametrize("make", [Circle2DVectorEnv, Circle2DMuJoCoVectorEnv])


@MODES
@pytest.mark.parametrize("level", [0, 1])
def test_reset_on_cost_terminates_in_steps_that_cost(make, level):
    envs = make(64, level=level, reset_on_cost=True, autoreset_mode="Disabled")
    envs.reset(seed=0)
    for _ in range(10):
        _, _, terminated, _, info = envs.step(np.full((64, 2), [-1.0, 0.0]))
        np.testing.assert_array_equal(terminated, info["cost"] == 1)
    assert terminated.any()


WEST = np.tile([-1.0, 0.0], (4, 1))


def costs(envs, steps=15):
    envs.reset(seed=0)
    return np.array([envs.step(WEST)[4]["cost"] for _ in range(steps)])


@MODES
@pytest.mark.parametrize("level", [0, 1])
def test_an_edit_of_the_cost_changes_the_environments(make, level, monkeypatch):
    """The edited cost is 3 for a touch, plus 1/4 for each step that ends above the x axis; it does
    not change the movement."""
    before = costs(make(4, level=level))
    assert set(before.ravel()) == {0.0, 1.0}

    def edited(config, position, contact):
        assert contact.dtype == np.bool_
        return 3.0 * contact + 0.25 * (position[..., 1] > 0)

    monkeypatch.setattr(task, "cost", edited)
    envs = make(4, level=level)
    above = envs.reset(seed=0)[0][:, 1] > 0
    assert 0 < above.sum() < 4
    # A rigid rim pushes balls along it, but not to the other side of the axis.
    np.testing.assert_array_equal(costs(envs), 3.0 * before + 0.25 * above)
