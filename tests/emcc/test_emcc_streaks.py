"""Streaks and the MCC of a rollout, against a loop that shares no code with them."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from emcc import count_streaks, longest_streak, longest_streaks, mcc, streak_bounds, streaks


def by_groupby(costs, threshold=0.0):
    groups = itertools.groupby(costs, key=lambda cost: cost > threshold)
    return max((len(list(group)) for unsafe, group in groups if unsafe), default=0)


episodes = st.lists(st.lists(st.sampled_from([0.0, 0.5, 2.0]), min_size=1, max_size=30), min_size=1)


@given(episodes, st.sampled_from([0.0, 0.5, 1.0]), st.integers(1, 9))
def test_equals_groupby_whatever_the_block(trajectories, threshold, block):
    """Small blocks: streaks and trajectories cross their borders in every way."""
    expected = [by_groupby(costs, threshold) for costs in trajectories]
    lengths = [len(costs) for costs in trajectories]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(streaks, "_BLOCK", block)
        found = longest_streaks(np.concatenate(trajectories), lengths, threshold)
    assert found.dtype == np.int64
    assert found.tolist() == expected
    assert [longest_streak(costs, threshold) for costs in trajectories] == expected
    shares = [streak / length for streak, length in zip(expected, lengths, strict=True)]
    assert mcc(trajectories, threshold) == max(shares)


@given(
    st.lists(st.lists(st.sampled_from([0.0, 0.5, 1.0, 2.0]), min_size=1, max_size=12), min_size=1),
    st.sampled_from([0.0, 0.5, 1.0]),
)
def test_counts_equal_groupby(trajectories, threshold):
    costs, lengths = np.concatenate(trajectories), [len(part) for part in trajectories]
    cost_steps, found = count_streaks(costs, lengths, threshold)
    assert cost_steps.tolist() == [sum(c > threshold for c in part) for part in trajectories]
    groups = [itertools.groupby(part, key=lambda cost: cost > threshold) for part in trajectories]
    assert found.tolist() == [sum(unsafe for unsafe, _ in of_one) for of_one in groups]


def test_equals_groupby_with_the_real_block():
    rng = np.random.default_rng(0)
    lengths = np.array([1, 7, 3 * streaks._BLOCK, 5, 50, streaks._BLOCK - 3, 1, 1000])
    costs = rng.random(lengths.sum()) < 0.9
    costs[8 : 2 * streaks._BLOCK + 11] = True  # one streak over two borders
    parts = np.split(costs, np.cumsum(lengths)[:-1])
    assert longest_streaks(costs, lengths).tolist() == [by_groupby(part) for part in parts]


def test_figure_1_of_the_paper():
    """Two trajectories of about the same cost: one long violation, and several short ones."""
    left = [0, 0, 0, 1, 1, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0]
    right = [0, 1, 1, 0, 0, 1, 1, 1, 0, 0, 0, 1, 0, 1, 1, 0, 0, 0, 1, 0]
    assert abs(sum(left) - sum(right)) <= 1
    assert (longest_streak(left), longest_streak(right)) == (8, 3)


def test_trajectories_of_different_lengths_in_one_rollout():
    assert mcc([[0, 1, 1, 0], [1, 1, 1, 0, 0, 0, 0, 0]]) == 2 / 4  # not 3 / 8


def test_only_costs_above_the_threshold_count():
    assert longest_streak([0.1, 0.5, 0.6, 0.7], threshold=0.5) == 2
    # The float32 next to 0.1 is above it, as it is when it comes as float64.
    costs = np.full(3, 0.1, np.float32)
    assert longest_streak(costs, 0.1) == longest_streak(costs.astype(float), 0.1) == 3


def test_accepts_tensors_and_numpy_types():
    costs = [0, 1, 1, 0]
    torch = pytest.importorskip("torch")
    tensor = torch.tensor(costs, dtype=torch.float32, requires_grad=True)
    for given_costs in (tensor, np.array(costs, bool), np.array(costs, np.uint8), tuple(costs)):
        assert longest_streak(given_costs) == 2
    assert mcc(torch.tensor([costs, costs])) == 0.5


@pytest.mark.parametrize("length", range(1, 10))
def test_bounds_hold_and_are_tight(length):
    """Over all 0/1 sequences of that length."""
    seen = {}
    for costs in itertools.product([0, 1], repeat=length):
        seen.setdefault(sum(costs), set()).add(by_groupby(costs))
    low, high = streak_bounds(list(seen), length)
    assert low.tolist() == [min(longest) for longest in seen.values()]
    assert high.tolist() == [max(longest) for longest in seen.values()]
    assert streak_bounds(length, length) == (length, length)


BAD = {
    "no step": (lambda: longest_streak([]), "costs must have at least one value"),
    "two axes": (lambda: longest_streak([[0, 1]]), r"costs must be 1-D, got shape \(1, 2\)"),
    "NaN": (lambda: longest_streak([0, np.nan]), "costs .* got nan at index 1"),
    "infinite": (lambda: longest_streak([np.inf, 0]), "costs .* got inf at index 0"),
    "negative": (lambda: longest_streak([0, 1, -1]), "costs .* >= 0, got -1 at index 2"),
    "threshold": (lambda: longest_streak([0], threshold=-1), "threshold must be >= 0, got -1"),
    "NaN threshold": (lambda: longest_streak([0], np.nan), "threshold must be finite"),
    "empty trajectory": (lambda: longest_streaks([1, 1], [2, 0]), "lengths .* got 0 at index 1"),
    "fraction": (lambda: longest_streaks([1, 1], [1.5, 0.5]), "lengths must be"),
    "sum": (lambda: longest_streaks([1, 1], [1, 2]), "add up to 3 steps, but there are 2 costs"),
    "empty rollout": (lambda: mcc([]), "the rollout has no trajectory"),
    "empty episode": (lambda: mcc([[1], []]), "costs of trajectory 1 must have at least one value"),
    "costs alone": (lambda: mcc([0, 1]), r"a number at index 0; one trajectory is \[costs\]"),
    "S > T": (lambda: streak_bounds(4, 3), "unsafe_steps must not exceed length"),
    "S < 0": (lambda: streak_bounds(-1, 3), "unsafe_steps .* got -1"),
    "T = 0": (lambda: streak_bounds(0, 0), "length .* got 0"),
    "S = 1/2": (lambda: streak_bounds(0.5, 3), "unsafe_steps must be whole numbers .* got 0.5"),
}


@pytest.mark.parametrize(("call", "message"), BAD.values(), ids=BAD)
def test_bad_input_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call()


@pytest.mark.filterwarnings("ignore:Creating an ndarray from ragged")  # numpy 1.23 warns first
@pytest.mark.parametrize("costs", ["text", ["a"], [None], [[1], [1, 2]], object()])
def test_costs_that_are_no_numbers(costs):
    with pytest.raises(TypeError, match="costs must be"):
        longest_streak(costs)
