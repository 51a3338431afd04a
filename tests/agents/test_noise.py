"""Random numbers are a function of seed, purpose and epoch, and of nothing else."""

import itertools

import numpy as np

from agents.lockstep.noise import Purpose, environment_seeds, steps_of_noise, stream


def take(seeds, purpose, epoch, n=100, shape=(2,)):
    steps = list(itertools.islice(steps_of_noise(seeds, purpose, epoch, shape), n))
    return np.array([s[0] for s in steps]), np.array([s[1] for s in steps])


def test_a_run_does_not_see_the_others():
    together = take([3, 1, 2], Purpose.EXPLORATION, 7)
    alone = take([1], Purpose.EXPLORATION, 7)
    for a, b in zip(together, alone, strict=True):
        np.testing.assert_array_equal(a[:, 1:2], b)
    many = environment_seeds([3, 1, 2], Purpose.ENVIRONMENT, 7, 4)
    assert many[4:8] == environment_seeds([1], Purpose.ENVIRONMENT, 7, 4)


def test_streams_differ_by_seed_purpose_and_epoch():
    draws = [
        stream(seed, purpose, epoch).integers(2**62)
        for seed in range(10)
        for purpose in Purpose
        for epoch in range(50)
    ]
    assert len(set(draws)) == len(draws)


def test_distributions():
    normal, uniform = take(range(50), Purpose.EXPLORATION, 0, n=200)
    assert abs(normal.mean()) < 0.02
    assert abs(normal.std() - 1) < 0.02
    assert uniform.min() >= -1
    assert uniform.max() < 1
    assert abs(uniform.mean()) < 0.02
    assert abs(uniform.std() - 1 / np.sqrt(3)) < 0.02
