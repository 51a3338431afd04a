"""Random numbers are a function of seed, purpose and epoch, and of nothing else."""

import functools
import itertools

import numpy as np
import pytest
import torch

from agents.lockstep import noise
from agents.lockstep.noise import Purpose, normal, steps_of_noise, stream, stream_seed, uniform


def take(draw, seeds, purpose, epoch, n=100, shape=(2,)):
    return np.array(list(itertools.islice(steps_of_noise(draw, seeds, purpose, epoch, shape), n)))


def test_streams_differ_by_seed_purpose_and_epoch():
    every = itertools.product(range(10), Purpose, range(50))
    draws = [stream(*one).integers(2**62) for one in every]
    assert len(set(draws)) == len(draws)


def test_the_stream_seed_of_a_task_does_not_change():
    """Nor does it depend on the module in a task's id. The expected bytes, lowest first, were
    printed by `b2sum -l 64` for the text "7 Circle2D-3-v0"."""
    assert stream_seed(7, "circle2d_mj:Circle2D-3-v0") == stream_seed(7, "Circle2D-3-v0")
    printed = bytes.fromhex("1a65c20d8eca0fee")
    assert stream_seed(7, "Circle2D-3-v0") == int.from_bytes(printed, "little")


@pytest.mark.parametrize(("draw", "deviation"), [(normal, 1.0), (uniform, 1 / np.sqrt(3))])
def test_means_ranges_and_standard_deviations(draw, deviation):
    drawn = take(draw, range(50), Purpose.EXPLORATION, 0, n=200)
    assert (drawn.mean(), drawn.std()) == pytest.approx((0, deviation), abs=0.02)
    assert draw is normal or -1 <= drawn.min() < drawn.max() < 1


@pytest.mark.parametrize("exponent", [0.0, 1.0, 2.0])
def test_correlated_numbers_are_uniform_and_have_their_spectrum(exponent):
    """Over 4000 independent series the numbers of a step have the uniform distribution's quantiles.

    The spectrum is that of the Gaussian numbers behind them: log power falls by `exponent` per unit
    of log frequency.
    """
    found = noise.correlated_uniform(np.random.default_rng(0), (64, 4000), exponent)
    assert found.shape == (64, 4000)
    assert found.dtype == np.float32
    shares = np.arange(0.1, 1.0, 0.1)
    for step in (0, 31, 63):
        quantiles = np.quantile(found[step], shares)
        np.testing.assert_allclose(quantiles, 2 * shares - 1, atol=0.05)  # 3 standard deviations
    inverse = torch.erfinv(torch.from_numpy(found).double().clamp(-1 + 1e-7, 1 - 1e-7)).numpy()
    power = (np.abs(np.fft.rfft(inverse, axis=0)) ** 2).mean(axis=1)[1:-1]
    slope = np.polyfit(np.log(np.arange(1, 32)), np.log(power), 1)[0]
    assert slope == pytest.approx(-exponent, abs=0.05)
    draw = functools.partial(noise.correlated_uniform, exponent=exponent)
    together = take(draw, [3, 1, 2], Purpose.RANDOM_ACTIONS, 7)
    np.testing.assert_array_equal(together[:, 1:2], take(draw, [1], Purpose.RANDOM_ACTIONS, 7))


def test_equal_seeds_on_different_tasks_have_independent_streams():
    tasks = [f"{name}-{level}-v0" for name in ("Circle2D", "Circle2DMuJoCo") for level in range(4)]
    found = {(seed, task): stream_seed(seed, task) for seed in range(50) for task in tasks}
    assert len(set(found.values())) == len(found)
    assert all(0 <= key < 2**64 for key in found.values())
    draws = [stream(key, Purpose.UPDATE).random(1000) for key in list(found.values())[:40]]
    # 5 standard deviations of 1/√1000.
    assert np.abs(np.corrcoef(draws) - np.eye(40)).max() < 0.16
