"""Bootstrap intervals: what they contain, and what decides them."""

import itertools
import sys

import numpy as np
import pytest

from emcc import difference, estimate
from emcc.table import intervals, mean_cell


def one(values, **options):
    return estimate({"x": values}, rng=np.random.default_rng(0), **options)["x"]


def test_interval_against_every_possible_resample():
    """4 seeds have 4^4 resamples, all equally likely: the exact percentiles are known."""
    values = [0.1, 0.4, 0.7, 0.9]
    means = [np.mean(pick) for pick in itertools.product(values, repeat=4)]
    low, high = np.quantile(means, [0.1, 0.9])
    result = one(values, level=0.8, resamples=100_000)
    assert result.value == pytest.approx(np.mean(values))
    assert result.low == pytest.approx(low, abs=0.011)  # the means lie on a grid
    assert result.high == pytest.approx(high, abs=0.011)


def test_tasks_are_strata():
    """Tasks of very different level and no spread: resampling across them would make some."""
    result = one([[0.0, 1.0], [0.0, 1.0], [0.0, 1.0]])
    assert (result.value, result.low, result.high) == (0.5, 0.5, 0.5)


def test_tasks_are_resampled_independently():
    """If one draw of seeds served both tasks, their opposite values would cancel always."""
    result = one([[0.0, 1.0], [1.0, 0.0]] * 3)
    assert result.low is not None
    assert result.high is not None
    assert result.low < 0.5 < result.high


def test_a_wider_level_gives_a_wider_interval():
    values = np.linspace(0, 1, 10)
    narrow, wide = one(values, level=0.5), one(values, level=0.99)
    assert wide.low < narrow.low < narrow.value < narrow.high < wide.high


@pytest.mark.parametrize("values", [[0.3], [[0.3, 0.3]]])
def test_one_seed_has_no_interval(values):
    result = one(values)
    assert (result.value, result.low, result.high) == (0.3, None, None)


def test_the_generator_decides():
    values = np.random.default_rng(1).random(5)
    first, second = one(values), one(values)
    assert (first.low, first.high) == (second.low, second.high)
    other = estimate({"x": values}, rng=np.random.default_rng(9), resamples=50)["x"]
    assert (first.low, first.high) != (other.low, other.high)


def test_runs_go_on_to_other_packages_but_stay_as_they_are():
    values = np.array([0.1, 0.2])
    result = one(values)
    values[0] = 9
    assert result.per_run.tolist() == [0.1, 0.2]
    with pytest.raises(ValueError, match="read-only"):
        result.per_run[0] = 9


BAD = {
    "no values": ([], {}, r"values of .x. must be \[runs\].*got shape \(0,\)"),
    "three axes": (np.zeros((2, 2, 2)), {}, r"values of .x. must be \[runs\]"),
    "NaN": ([0.1, np.nan], {}, "values of 'x' must be finite, got nan at index 1"),
    "level": ([0.1], {"level": 1.0}, r"level must be in \(0, 1\), got 1.0"),
    "resamples": ([0.1], {"resamples": 0}, "resamples must be >= 1, got 0"),
}


@pytest.mark.parametrize(("values", "options", "message"), BAD.values(), ids=BAD)
def test_bad_input_is_named(values, options, message):
    with pytest.raises(ValueError, match=message):
        one(values, **options)


@pytest.mark.filterwarnings("ignore:Creating an ndarray from ragged")  # numpy 1.23 warns first
def test_ragged_tasks_and_a_seed_for_a_generator():
    with pytest.raises(TypeError, match="values of 'x' must be "):
        one([[0.1, 0.2], [0.1]])
    with pytest.raises(TypeError, match=r"rng must be a numpy.random.Generator, got int"):
        estimate({"x": [0.1]}, rng=0)  # pyright: ignore[reportArgumentType]


def test_difference_against_every_possible_resample():
    """27 resamples of one side times 4 of the other, all equally likely."""
    first, second = [0.1, 0.5, 0.6], [0.9, 0.3]
    gaps = [
        np.mean(after) - np.mean(before)
        for before in itertools.product(first, repeat=3)
        for after in itertools.product(second, repeat=2)
    ]
    low, high = np.quantile(gaps, [0.08, 0.92])
    result = difference(first, second, rng=np.random.default_rng(0), level=0.84, resamples=100_000)
    assert result.value == pytest.approx(0.6 - 0.4)
    assert result.low == pytest.approx(low, abs=1e-9)
    assert result.high == pytest.approx(high, abs=1e-9)


def test_difference_with_one_seed_on_a_side_has_no_interval():
    for sides in (([0.5], [0.1, 0.2]), ([0.1, 0.2], [0.5])):
        result = difference(*sides, rng=np.random.default_rng(0))
        assert (result.low, result.high) == (None, None)
        assert abs(result.value) == pytest.approx(0.35)


def test_difference_names_bad_input():
    with pytest.raises(ValueError, match="values of 'second' must be finite"):
        difference([0.1], [np.nan], rng=np.random.default_rng(0))
    with pytest.raises(TypeError, match="rng must be"):
        difference([0.1], [0.1], rng=0)  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="level must be"):
        difference([0.1], [0.1], rng=np.random.default_rng(0), level=0)


VALUES = [0.2, 0.4, 0.6, 0.7, 0.9]


def test_a_cell_has_the_t_interval_from_five_runs_on():
    """By hand: t of 4 degrees of freedom is 2.776, the standard error .2702 / sqrt(5) = .1208."""
    pytest.importorskip("scipy", minversion="1.15")
    assert mean_cell(VALUES, 3, seed=0) == "0.560 [0.225, 0.895]"
    assert intervals() == "[95 % t interval], or the range of fewer than 5 runs"
    check_small_cells()


def test_a_cell_without_scipy_has_the_range_below_ten_runs_and_the_bootstrap_from_then_on(
    monkeypatch,
):
    """Of five 0 and five 1, resampled sums are binomial: P(sum <= 1) = .011, P(sum <= 2) = .055."""
    for name in ("scipy", "scipy.special"):
        monkeypatch.setitem(sys.modules, name, None)
    assert mean_cell(VALUES, 3, seed=0) == "0.560 range 0.200 to 0.900"
    assert mean_cell([0, 1] * 4 + [1], 2, seed=0) == "0.56 range 0.00 to 1.00"
    assert mean_cell([0, 1] * 5, 3, seed=0) == "0.500 [0.200, 0.800]"
    assert intervals() == (
        "[95 % bootstrap interval], or the range of fewer than 10 runs, whose t interval needs "
        "scipy>=1.15"
    )
    check_small_cells()


def check_small_cells():
    assert mean_cell(VALUES[:4], 3, seed=0) == "0.475 range 0.200 to 0.700"
    assert mean_cell(VALUES[:1], 2, seed=0) == "0.20"
    assert mean_cell([*VALUES, None], 2, seed=0) == "\N{EN DASH}"
