"""Advantages from their definition; episodes packed end to end, and what is drawn from them."""

import numpy as np
import pytest
import torch

from agents.on_policy.epoch import BLOCK, Packing, advantages, blocks, minibatches


@pytest.mark.parametrize(("discount", "gae_lambda"), [(0.99, 0.95), (0.9, 1.0), (0.9, 0.0)])
def test_advantages_are_sums_of_errors(discount, gae_lambda):
    """A_t = Σ_k (γλ)^k δ_{t+k} to the episode's end; some end terminally, some are cut off. What
    lies beyond an episode is not a number, and must not matter."""
    rng, length = np.random.default_rng(0), np.array([1, 2, 7, 12, 30, 0])
    during = np.arange(30)[:, None] < length
    reward, value, next_value = np.where(during, rng.normal(size=(3, 30, 6)), np.nan)
    ends = np.arange(30)[:, None] == length - 1
    terminal = ends & (np.arange(6) % 2 == 0)
    found = advantages(reward, value, next_value, terminal, during, discount, gae_lambda)
    expected = np.zeros((30, 6))
    for n in range(6):
        for t in range(length[n]):
            for k in range(length[n] - t):
                error = reward[t + k, n] - value[t + k, n]
                if not terminal[t + k, n]:
                    error += discount * next_value[t + k, n]
                expected[t, n] += (discount * gae_lambda) ** k * error
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)


def during(length, steps):
    return np.arange(steps)[:, None] < np.array(length)


def test_packing_round_trip():
    """Runs of 600, 1, 0 and 512 steps, with columns of vectors; NaN lies beyond the episodes."""
    lengths = [300, 300, 0, 1, 0, 0, 500, 12]
    packing = Packing(during(lengths, 500), runs=4)
    assert packing.steps.tolist() == [600, 1, 0, 512]
    assert packing.size == 2 * BLOCK
    inside = during(lengths, 500)[..., None]
    values = np.where(inside, np.random.default_rng(0).normal(size=(500, 8, 3)), np.nan)
    packed = packing.pack(values)
    for run in range(4):
        episodes = [values[: lengths[n], n] for n in (2 * run, 2 * run + 1)]
        expected = np.concatenate(episodes).astype(np.float32)
        np.testing.assert_array_equal(packed[run, : len(expected)], expected)
        assert not packed[run, len(expected) :].any()
        means = packing.weight[run] @ packed[run]
        if len(expected):
            np.testing.assert_allclose(means, expected.mean(axis=0), atol=1e-6)
    back = packing.unpack(packed[..., 1])
    np.testing.assert_array_equal(back, np.where(inside, values, 0.0)[..., 1].astype(np.float32))
    np.testing.assert_allclose(packing.weight.sum(axis=1), [1, 1, 0, 1], rtol=1e-6)


@pytest.mark.parametrize(("steps", "size"), [(0, 1), (1, 1), (512, 1), (513, 2), (1025, 3)])
def test_rows_come_in_whole_blocks(steps, size):
    packing = Packing(during([steps, 0], 1100), runs=2)
    assert packing.size == size * BLOCK
    column = torch.arange(2.0 * packing.size * 5).view(2, -1, 5)
    parts = list(blocks(column, column[..., 0]))
    assert [part.shape for part, _ in parts] == [(2, BLOCK, 5)] * size
    assert torch.equal(torch.cat([part for part, _ in parts], dim=1), column)
    assert torch.equal(torch.cat([part for _, part in parts], dim=1), column[..., 0])


def generators(*seeds):
    return [np.random.default_rng(seed) for seed in seeds]


def test_a_pass_takes_every_row_once():
    steps = np.array([1000, 0, 3, 256])
    passes = list(minibatches(steps, 256, generators(0, 1, 2, 3)))
    assert len(passes) == 4
    for run, n in enumerate(steps):
        taken = torch.cat([rows[run][weight[run] > 0] for rows, weight in passes])
        assert sorted(taken.tolist()) == list(range(n))
        for k, (rows, weight) in enumerate(passes):
            assert rows.shape == weight.shape == (4, 256)
            held = int(np.clip(n - 256 * k, 0, 256))
            expected = [1 / max(held, 1)] * held + [0.0] * (256 - held)
            np.testing.assert_allclose(weight[run], expected, rtol=1e-6)
    first = passes[0][0][0]
    assert (first > 255).sum() > 100  # not in the order of time


def test_an_order_is_the_runs_own():
    """The stream decides alone, whatever the other runs have; the next pass takes another order."""
    streams = generators(5)
    (alone, _), (following, _) = (next(minibatches(np.array([90]), 96, streams)) for _ in "12")
    among = list(minibatches(np.array([300, 90]), 96, generators(7, 5)))
    assert torch.equal(among[0][0][1], alone[0])
    assert not torch.equal(alone, following)
