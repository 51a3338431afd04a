"""The random streams of environments: known answers, independence, seeds."""

import numpy as np
import pytest

from circle2d_mj.core.streams import Streams, keys_of_seeds, philox


def scalar_philox(key, counter):
    """The same generator in plain integers, written after the paper."""
    k = [key % 2**32, key >> 32]
    c = [counter % 2**32, counter >> 32, 0, 0]
    for _ in range(10):
        a, b = 0xD2511F53 * c[0], 0xCD9E8D57 * c[2]
        c = [(b >> 32) ^ c[1] ^ k[0], b % 2**32, (a >> 32) ^ c[3] ^ k[1], a % 2**32]
        k = [(k[0] + 0x9E3779B9) % 2**32, (k[1] + 0xBB67AE85) % 2**32]
    return c


def test_against_plain_integers():
    rng = np.random.default_rng(0)
    keys, counters = rng.integers(2**64, size=(2, 200), dtype=np.uint64)
    expected = [scalar_philox(int(k), int(c)) for k, c in zip(keys, counters, strict=True)]
    np.testing.assert_array_equal(philox(keys, counters), np.array(expected, dtype=np.uint64))


def test_a_stream_does_not_depend_on_the_others():
    many = Streams(np.arange(10, dtype=np.uint64))
    alone = Streams(np.array([7], dtype=np.uint64))
    many.uniform(np.array([0, 1, 2]))
    for _ in range(3):
        together = many.uniform(np.array([3, 7]))
        np.testing.assert_array_equal(together[1:], alone.uniform(np.array([0])))


def test_several_draws_are_those_of_as_many_calls():
    once, often = (Streams(np.arange(5, dtype=np.uint64)) for _ in range(2))
    index = np.array([3, 1])
    calls = [often.uniform(index) for _ in range(3)]
    np.testing.assert_array_equal(once.uniform(index, draws=3), np.hstack(calls))
    np.testing.assert_array_equal(once.uniform(index), often.uniform(index))
    np.testing.assert_array_equal(once.counters, often.counters)


def test_uniform():
    draws = Streams(np.arange(50_000, dtype=np.uint64)).uniform(np.arange(50_000))
    assert (draws > 0).all()
    assert (draws < 1).all()
    np.testing.assert_allclose(draws.mean(axis=0), 0.5, atol=0.01)
    np.testing.assert_allclose(np.corrcoef(draws.T), np.eye(4), atol=0.02)


NO_SEEDS = [("1", TypeError, "seed must be an integer or a sequence of integers, got '1'")]
NO_SEEDS += [(seed, TypeError, "seed must be an integer") for seed in (1.5, [1, 2.5], True)]
NO_SEEDS += [(-1, ValueError, r"seed must be in \[0, 2\*\*64\), got -1")]
NO_SEEDS += [(2**64 - 1, ValueError, "seed must be in")]
NO_SEEDS += [([1, 2, 3], ValueError, r"one entry per environment \(2\)")]


@pytest.mark.parametrize(("seed", "error", "message"), NO_SEEDS)
def test_bad_seeds(seed, error, message):
    with pytest.raises(error, match=message):
        keys_of_seeds(seed, 2)


def test_known_answers():
    """Philox4x32-10 of the reference implementation (Random123, file kat_vectors)."""
    zero = np.zeros(1, dtype=np.uint64)
    words = [hex(int(w)) for w in philox(zero, zero)[0]]
    assert words == ["0x6627e8d5", "0xe169c58d", "0xbc57ac4c", "0x9b00dbd8"]
