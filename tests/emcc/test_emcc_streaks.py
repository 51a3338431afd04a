"""Streaks and the MCC of a rollout against itertools.groupby; EMCC and CVaR against their
definitions in exact fractions; EMCC by parts of training."""

import itertools
import json
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from emcc import (
    cost_rate,
    count_streaks,
    cvar,
    emcc,
    emcc_by_part,
    longest_streak,
    longest_streaks,
    mcc,
    streak_bounds,
    streaks,
    worst,
)


def by_groupby(costs, threshold=0.0):
    """Return the length of each streak."""
    groups = itertools.groupby(costs, key=lambda cost: cost > threshold)
    return [len(list(group)) for unsafe, group in groups if unsafe]


costs_of_steps = st.lists(st.sampled_from([0.0, 0.5, 1.0, 2.0]), min_size=1, max_size=30)


@given(st.lists(costs_of_steps, min_size=1), st.sampled_from([0.0, 0.5, 1.0]), st.integers(1, 9))
def test_streaks_equal_groupbys_whatever_the_block(trajectories, threshold, block):
    """Blocks are small, so that streaks and trajectories cross their borders in every way."""
    every = [by_groupby(costs, threshold) for costs in trajectories]
    expected = [max(found, default=0) for found in every]
    joined, lengths = np.concatenate(trajectories), [len(costs) for costs in trajectories]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(streaks, "_BLOCK", block)
        found = longest_streaks(joined, lengths, threshold)
        cost_steps, counts = count_streaks(joined, lengths, threshold)
    assert found.dtype == np.int64
    assert found.tolist() == expected
    assert counts.tolist() == [len(found) for found in every]
    assert cost_steps.tolist() == [sum(found) for found in every]
    assert [longest_streak(costs, threshold) for costs in trajectories] == expected
    shares = [streak / length for streak, length in zip(expected, lengths, strict=True)]
    assert mcc(trajectories, threshold) == max(shares)


def test_figure_1_of_the_paper():
    """Two trajectories of about the same cost: one long violation, and several short ones."""
    left = [0, 0, 0, 1, 1, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0]
    right = [0, 1, 1, 0, 0, 1, 1, 1, 0, 0, 0, 1, 0, 1, 1, 0, 0, 0, 1, 0]
    assert abs(sum(left) - sum(right)) <= 1
    assert (longest_streak(left), longest_streak(right)) == (8, 3)


def test_only_costs_above_the_threshold_count():
    assert longest_streak([0.1, 0.5, 0.6, 0.7], threshold=0.5) == 2
    # The float32 nearest to 0.1 is above it, also after a conversion to float64.
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
    """Against all 0/1 sequences of that length."""
    seen = {}
    for costs in itertools.product([0, 1], repeat=length):
        seen.setdefault(sum(costs), set()).add(max(by_groupby(costs), default=0))
    low, high = streak_bounds(list(seen), length)
    assert low.tolist() == [min(longest) for longest in seen.values()]
    assert high.tolist() == [max(longest) for longest in seen.values()]
    assert streak_bounds(length, length) == (length, length)


def tail_by_definition(values, alpha, ties):
    """Return the mean of the tail. alpha and values are Fractions; for "split", each value is
    repeated so often that the tail holds a whole number of values."""
    if ties == "all":
        count = len(values)
        reached = [v for v in values if sum(w <= v for w in values) >= (1 - alpha) * count]
        kept = [v for v in values if v >= min(reached)]
    else:
        copies = sorted((v for v in values for _ in range(alpha.denominator)), reverse=True)
        kept = copies[: alpha.numerator * len(values)]
    return sum(kept) / len(kept)


shares = st.fractions(0, 1, max_denominator=8)
alphas = st.fractions(Fraction(1, 40), 1, max_denominator=40)


@given(st.lists(shares, min_size=1, max_size=40), alphas, st.sampled_from(["all", "split"]))
def test_emcc_and_cvar_equal_their_definition(values, alpha, ties):
    expected = float(tail_by_definition(values, alpha, ties))
    floats = [float(value) for value in values]
    assert emcc(floats, float(alpha), ties) == pytest.approx(expected, rel=1e-12)
    assert emcc(floats, 1e-15, ties) == max(floats)
    is_worst = worst(floats, float(alpha), ties)
    kept = [value for value, chosen in zip(values, is_worst, strict=True) if chosen]
    assert len(kept) == sum(value >= min(kept) for value in values)
    if ties == "all":
        assert float(sum(kept) / len(kept)) == pytest.approx(expected, rel=1e-12)
    else:  # the values above the border do not fill the tail; with those at it, they do
        assert sum(value > min(kept) for value in kept) < alpha * len(values) <= len(kept)
    scaled = [10 * value - 5 for value in floats]
    assert cvar(scaled, float(alpha), ties) == pytest.approx(10 * expected - 5, abs=1e-12)


def test_ties_are_split_by_hand():
    """The worst tenth of 25 values is two and a half values: of one 1, four .4 and twenty 0."""
    values = [0.0] * 10 + [0.4] * 4 + [1.0] + [0.0] * 10
    assert emcc(values, 0.1) == pytest.approx((1 + 1.5 * 0.4) / 2.5)
    assert emcc(values, 0.1, "all") == pytest.approx((1 + 4 * 0.4) / 5)
    assert worst(values).tolist() == [value > 0 for value in values]
    assert emcc([0.1], 0.1) == emcc([0.1] * 7, 0.3) == 0.1  # exactly
    # Ten or eleven of a hundred values are .5: "all" jumps.
    few = [[0.5] * count + [0.0] * (100 - count) for count in (11, 10)]
    assert [emcc(values, 0.1) for values in few] == [0.5, 0.5]
    assert [emcc(values, 0.1, "all") for values in few] == pytest.approx([0.5, 0.05])


PRINTED = Path(__file__).parents[2] / "agents" / "paper" / "printed.json"


@pytest.mark.skipif(not PRINTED.exists(), reason="emcc alone lacks the paper's numbers")
def test_the_paper_splits_ties():
    """In four cells of the paper's table CVaR_0.5 is twice J_C: half of the episodes cost nothing,
    and the tail is the other half. With `ties="all"` the tail would be all episodes, and CVaR
    would be J_C."""
    cells = [
        (j_c, measures["CVaR_0.5"][name])
        for measures in json.loads(PRINTED.read_text())["results"].values()
        for name, j_c in measures["J_C"].items()
    ]
    rounding = 0.016  # J_C and CVaR have two digits; J_C is doubled
    doubled = [(low, high) for low, high in cells if low > 0.1 and abs(high - 2 * low) < rounding]
    assert doubled == [(11.61, 23.23), (1.65, 3.29), (0.33, 0.66), (42.6, 85.2)]
    for low, high in doubled:
        costs = [0.0] * 50 + [high] * 50
        assert cvar(costs) == high
        assert (np.mean(costs), cvar(costs, ties="all")) == pytest.approx((low, low), abs=0.01)
    # With split ties, CVaR_0.5 is at most twice the mean cost.
    assert all(high < 2 * low + rounding for low, high in cells)


@pytest.mark.parametrize("count", [10, 20, 30, 70, 1000, 10_000])
@pytest.mark.parametrize("alpha", [0.1, 0.3, 0.7, 1 - 0.9, 1 - 0.3])
def test_the_quantile_is_not_moved_by_rounding(count, alpha):
    """For the values 1..n, F^-1(1 - alpha) is (1 - alpha) n, and this value belongs to the tail."""
    tail = round(alpha * count)
    values = np.arange(1, count + 1)
    assert cvar(values, alpha, "all") == pytest.approx((2 * count - tail) / 2, rel=1e-13)
    assert cvar(values, alpha, "split") == pytest.approx((2 * count - tail + 1) / 2, rel=1e-13)


def test_parts_are_exact_at_their_borders():
    """Every rollout has a different MCC, so that one in the wrong part would change a mean."""
    total = 10_000
    starts = [0, 3299, 3300, 6599, 6600, 9900, 9901, 9999]
    values = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8]
    parts = emcc_by_part(values, starts, total, alpha=1.0)
    assert parts == {
        0.33: pytest.approx(0.15),
        0.66: pytest.approx(0.35),
        0.99: pytest.approx(0.55),  # with step 9900, but without the last 1 %
    }


@pytest.mark.parametrize("total", [100, 700, 4300, 10**6, 10**12 + 100])
def test_borders_belong_to_the_later_part(total):
    border = total // 100 * 33
    starts = np.array([border - 1, border, total // 100 * 66])
    assert emcc_by_part([0.1, 0.2, 0.3], starts, total) == {0.33: 0.1, 0.66: 0.2, 0.99: 0.3}


def test_parts_take_alpha_and_ties():
    values, starts = [0.9, 0.5, 0.5, 0.0] * 3, [0, 1, 2, 3, 40, 41, 42, 43, 70, 71, 72, 73]
    assert set(emcc_by_part(values, starts, 100, 0.5, "split").values()) == {0.7}
    everything = emcc_by_part(values, starts, 100, 0.5, "all")
    assert everything == dict.fromkeys((0.33, 0.66, 0.99), pytest.approx(1.9 / 3))
    assert emcc_by_part(values, starts, 100) == dict.fromkeys((0.33, 0.66, 0.99), 0.9)


def test_cost_rate():
    assert cost_rate([1.0, 0.0, 2.0], 3) == 1.0
    assert cost_rate(5.0, [10, 10]) == 0.25
    assert cost_rate([2.0, 3.0], [10, 10]) == cost_rate([2.0, 3.0], 20) == 0.25
    assert cost_rate([1.0, 0.0, 0.0, 1.0], [1, 3]) == 0.5
    assert cost_rate([2.0, 3.0], [10]) == cost_rate([5.0], [4, 6]) == 0.5


VALUES, STARTS = [0.1, 0.2, 0.3], [0, 40, 70]
BAD = {
    "no step": (lambda: longest_streak([]), "costs must have at least one value"),
    "NaN": (lambda: longest_streak([0, np.nan]), "costs .* got nan at index 1"),
    "negative": (lambda: longest_streak([0, 1, -1]), "costs .* >= 0, got -1 at index 2"),
    "threshold": (lambda: longest_streak([0], threshold=-1), "threshold must be >= 0, got -1"),
    "empty trajectory": (lambda: longest_streaks([1, 1], [2, 0]), "lengths .* got 0 at index 1"),
    "sum": (lambda: longest_streaks([1, 1], [1, 2]), "add up to 3 steps, but there are 2 costs"),
    "empty rollout": (lambda: mcc([]), "costs must hold one array for each trajectory"),
    "empty episode": (lambda: mcc([[1], []]), "costs of trajectory 1 must have at least one value"),
    "costs alone": (lambda: mcc([0, 1]), "costs must hold one array for each trajectory"),
    "S > T": (lambda: streak_bounds(4, 3), "unsafe_steps must not exceed length"),
    "no values": (lambda: emcc([]), "mcc_values must have at least one value"),
    "a sum": (lambda: emcc([0.5, 8.0]), r"mcc_values .* in \[0, 1\], got 8.0 at index 1"),
    "NaN MCC": (lambda: emcc([np.nan]), "mcc_values .* got nan"),
    "alpha 0": (lambda: emcc([0.1], 0.0), r"alpha must be in \(0, 1\], got 0.0"),
    "alpha > 1": (lambda: emcc([0.1], 1.1), r"alpha must be in \(0, 1\], got 1.1"),
    "ties": (lambda: emcc([0.1], 0.5, "some"), "ties must be one of .*split.*all.*, got 'some'"),
    "empty part": (lambda: emcc_by_part([0, 0], [0, 70], 99), "no rollout .* in part 0.66 of 99"),
    "start": (lambda: emcc_by_part(VALUES, [0, 40, 100], 100), "start_steps .* got 100 at index 2"),
    "fraction": (lambda: emcc_by_part(VALUES, [0.5, 40, 70], 100), "start_steps must be whole"),
    "total": (lambda: emcc_by_part(VALUES, STARTS, 0), "total_steps must be >= 1, got 0"),
    "unequal": (lambda: emcc_by_part(VALUES, [0, 40], 100), "3 mcc_values, but 2 start_steps"),
    "no steps": (lambda: cost_rate([0.0], 0), "steps add up to 0"),
    "negative cost": (lambda: cost_rate([-1.0], 5), "costs .* got -1.0"),
    "other costs": (lambda: cost_rate([1, 2, 3], [5, 5]), "3 costs do not fit 2 lengths"),
}


@pytest.mark.parametrize(("call", "message"), BAD.values(), ids=BAD)
def test_bad_input_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call()


TEXT = {
    "text": (lambda: longest_streak("text"), "costs must be"),
    "None": (lambda: longest_streak([None]), "costs must be"),
    "ragged": (lambda: longest_streak([[1], [1, 2]]), "costs must be"),
    "alpha": (lambda: emcc([0.1], "0.5"), "alpha must be a number"),
    "total": (lambda: emcc_by_part(VALUES, STARTS, 100.5), "must be an integer, got 100.5"),
}


@pytest.mark.filterwarnings("ignore:Creating an ndarray from ragged")  # numpy 1.23 warns first
@pytest.mark.parametrize(("call", "message"), TEXT.values(), ids=TEXT)
def test_what_is_no_number_is_named(call, message):
    with pytest.raises(TypeError, match=message):
        call()
