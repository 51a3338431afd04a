"""Statistics of few runs: by hand, by brute force, and by simulating what they promise."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from emcc import statistics

pytest.importorskip("scipy", minversion="1.15")
import scipy.stats

SIMULATIONS = 1_500


def margin(rate, simulations=SIMULATIONS):
    """Four standard errors of a share that was counted in so many simulations."""
    return 4 * math.sqrt(rate * (1 - rate) / simulations)


DISTRIBUTIONS = {
    "normal": (lambda rng, shape: rng.normal(size=shape), 0.0),
    "log-normal": (lambda rng, shape: rng.lognormal(sigma=1.0, size=shape), math.exp(0.5)),
    "two basins": (
        lambda rng, shape: np.where(rng.random(shape) < 0.8, 0.0, 10.0) + rng.normal(size=shape),
        2.0,
    ),
}


def test_mean_interval_by_hand():
    """2, 4, 4, 4, 6: mean 4, deviation √2, half-width 2.776 √2 / √5 (t of 4 degrees of freedom)."""
    found = statistics.mean_interval([2, 4, 4, 4, 6])
    assert (found.value, found.kind, found.runs) == (4.0, "t", 5)
    assert found.high - found.value == pytest.approx(2.7764451 * math.sqrt(2) / math.sqrt(5))
    assert found.value - found.low == pytest.approx(found.high - found.value)


def test_an_interval_ends_where_no_value_can_be():
    """0, 0, 0, 0, 1: mean .2, half-width 2.776 √.2 / √5 = .555."""
    assert statistics.mean_interval([0, 0, 0, 0, 1]).low == pytest.approx(0.2 - 0.2 * 2.7764451)
    found = statistics.mean_interval([0, 0, 0, 0, 1], bounds=(0, 1))
    assert (found.low, found.high) == (0.0, pytest.approx(0.2 + 0.2 * 2.7764451))
    assert statistics.mean_interval([1, 1, 1, 1, 0], bounds=(0, 1)).high == 1.0
    with pytest.raises(ValueError, match=r"values must be within \(0, 1\), got 0.0 to 2.0"):
        statistics.mean_interval([0, 2], bounds=(0, 1))


def test_fewer_than_five_runs_have_a_range_and_one_has_nothing():
    found = statistics.mean_interval([1.0, 5.0, 3.0])
    assert (found.value, found.low, found.high, found.kind) == (3.0, 1.0, 5.0, "range")
    assert statistics.mean_interval([7.0]) == statistics.Interval(7.0, None, None, "range", 1)


def coverage(name, runs):
    """Share of simulations in which the 95 % interval holds the true mean."""
    draw, true = DISTRIBUTIONS[name]
    values = draw(np.random.default_rng(0), (SIMULATIONS, runs))
    found = [statistics.mean_interval(of_one) for of_one in values]
    return np.mean([interval.low <= true <= interval.high for interval in found])


@pytest.mark.parametrize("runs", [5, 10, 20])
def test_the_t_interval_covers_normal_means_as_it_says(runs):
    assert coverage("normal", runs) == pytest.approx(0.95, abs=margin(0.95))


@pytest.mark.parametrize(
    ("name", "runs", "stated"),
    [
        ("log-normal", 5, 0.79),
        ("log-normal", 10, 0.86),
        ("two basins", 5, 0.65),
        ("two basins", 10, 0.91),
    ],
)
def test_the_coverage_that_the_documentation_states(name, runs, stated):
    assert coverage(name, runs) == pytest.approx(stated, abs=margin(stated) + 0.03)


@pytest.mark.parametrize(("runs", "true"), [(10, 0.9), (10, 0.5), (5, 0.2), (20, 0.97)])
def test_the_interval_of_a_share_covers_it_at_least_as_often_as_it_says(runs, true):
    """Exactly: the sum of the binomial probabilities of the counts whose interval holds it."""
    held = 0.0
    for count in range(runs + 1):
        found = statistics.share(count, runs)
        probability = math.comb(runs, count) * true**count * (1 - true) ** (runs - count)
        held += probability * (found.low <= true <= found.high)
    assert held >= 0.95


def test_share_by_hand():
    """Of 10 of 10 the lower end solves p¹⁰ = 0.025."""
    assert statistics.share(10, 10).low == pytest.approx(0.025**0.1)
    assert statistics.share(9, 10).low == pytest.approx(0.555, abs=5e-4)
    nobody = statistics.share(0, 10)
    assert (nobody.value, nobody.low) == (0.0, 0.0)
    assert nobody.high == pytest.approx(1 - 0.025**0.1)


def test_iqm_by_hand():
    assert statistics.iqm([100, 1, 2, 3, 4, 5, 6, -100]) == pytest.approx((2 + 3 + 4 + 5) / 4)
    assert statistics.iqm([[0, 1], [10, 2], [3, 50], [4, 5]]) == pytest.approx((2 + 3 + 4 + 5) / 4)


small = st.lists(st.integers(0, 4), min_size=1, max_size=6)


@given(small, small)
def test_probability_of_improvement_is_a_count_over_pairs(a, b):
    pairs = [1.0 if y < x else 0.5 if y == x else 0.0 for x in a for y in b]
    assert statistics.probability_of_improvement(a, b) == pytest.approx(sum(pairs) / len(pairs))


@given(
    st.lists(st.integers(0, 5), min_size=1, max_size=20), st.lists(st.integers(-1, 6), min_size=1)
)
def test_profile_is_a_count(values, thresholds):
    found = statistics.profile(values, thresholds)
    shares = [sum(v > t for v in values) / len(values) for t in thresholds]
    np.testing.assert_allclose(found, shares, atol=1e-15)


def test_mean_difference_is_welchs_interval():
    rng = np.random.default_rng(5)
    a, b = rng.normal(size=8), rng.normal(1.0, 3.0, size=11)
    found = statistics.mean_difference(a, b)
    expected = scipy.stats.ttest_ind(b, a, equal_var=False).confidence_interval(0.95)
    assert (found.low, found.high) == pytest.approx((expected.low, expected.high))
    assert (found.value, found.kind, found.runs) == (pytest.approx(b.mean() - a.mean()), "t", 8)
    few = statistics.mean_difference(a[:4], b)
    assert (few.low, few.high, few.kind, few.runs) == (None, None, "range", 4)
    same = statistics.mean_difference([1.0] * 5, [3.0] * 5)
    assert (same.value, same.low, same.high) == (2.0, 2.0, 2.0)


def test_the_bootstrap_draws_each_task_on_its_own():
    """Two tasks of opposite values: drawn together, the mean would always be 0."""
    values = np.array([[k, -k] for k in range(-4, 5)], dtype=float)
    found = statistics.bootstrap(lambda runs: runs.mean(), values, rng=np.random.default_rng(0))
    assert found.low < -0.5
    assert found.high > 0.5
    few = statistics.bootstrap(statistics.iqm, [1, 2, 3, 4], rng=np.random.default_rng(0))
    assert (few.low, few.high, few.kind) == (None, None, "range")


BAD = {
    "empty": (lambda: statistics.mean_interval([]), "values must have at least one value"),
    "NaN": (lambda: statistics.iqm([1.0, math.nan]), "values must be finite, got nan"),
    "level": (lambda: statistics.mean_interval([1, 2], level=95), r"level must be in \(0, 1\)"),
    "count": (lambda: statistics.share(11, 10), "count must be at most runs, got 11 of 10"),
    "tasks": (
        lambda: statistics.probability_of_improvement([[1, 2]], [[1]]),
        "the same tasks, got 2 and 1",
    ),
    "shape": (lambda: statistics.iqm(np.zeros((2, 2, 2))), r"\[runs\] or \[runs, tasks\]"),
}


@pytest.mark.parametrize(("call", "message"), BAD.values(), ids=BAD)
def test_bad_input_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_generators_are_explicit():
    with pytest.raises(TypeError, match="rng must be a numpy"):
        statistics.bootstrap(statistics.iqm, [1, 2], rng=None)
