"""Statistics of few runs against hand calculation, brute force, SciPy and simulation."""

import itertools
import math
from fractions import Fraction
from statistics import variance

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from emcc import equivalence_test, holm, permutation_test, statistics

pytest.importorskip("scipy", minversion="1.15")
import scipy.stats

RNG = np.random.default_rng(0)


def test_an_interval_stays_within_the_bounds_of_values():
    """0, 0, 0, 0, 1 has the mean .2 and the half-width 2.776 √.2 / √5 = .555."""
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


def two_basins(rng, shape):
    return np.where(rng.random(shape) < 0.8, 0.0, 10.0) + rng.normal(size=shape)


STATED = {
    "normal": (lambda rng, shape: rng.normal(size=shape), 0.0, 0.95),
    "log-normal": (lambda rng, shape: rng.lognormal(size=shape), math.exp(0.5), 0.82),
    "two basins": (two_basins, 2.0, 0.70),
}


@pytest.mark.parametrize(("draw", "true", "stated"), STATED.values(), ids=STATED)
def test_the_t_interval_of_5_runs_covers_the_mean_as_often_as_the_documentation_says(
    draw, true, stated
):
    """Within four standard errors of the share of simulations whose interval covers the mean."""
    simulations = 4_000
    values = draw(np.random.default_rng(0), (simulations, 5))
    found = [statistics.mean_interval(of_one) for of_one in values]
    covered = np.mean([interval.low <= true <= interval.high for interval in found])
    error = math.sqrt(stated * (1 - stated) / simulations)
    assert covered == pytest.approx(stated, abs=4 * error)


@pytest.mark.parametrize("level", [0.5, 0.95])
@pytest.mark.parametrize("runs", [7, 10])
def test_intervals_of_shares_are_scipys_exact_ones(runs, level):
    for count in range(runs + 1):
        found = statistics.share(count, runs, level)
        expected = scipy.stats.binomtest(count, runs).proportion_ci(level, method="exact")
        assert (found.low, found.high) == pytest.approx(tuple(expected), abs=1e-9)
        assert found.value == count / runs
    assert (statistics.share(0, runs).low, statistics.share(runs, runs).high) == (0.0, 1.0)


def test_iqm_by_hand():
    assert statistics.iqm([100, 1, 2, 3, 4, 5, 6, -100]) == pytest.approx((2 + 3 + 4 + 5) / 4)
    assert statistics.iqm([100, 0, 2, 3, 4, 5, -100]) == (0 + 2 + 3 + 4 + 5) / 5  # 7 // 4 = 1
    assert statistics.iqm([[0, 1], [10, 2], [3, 50], [4, 5]]) == pytest.approx((2 + 3 + 4 + 5) / 4)


small = st.lists(st.integers(0, 4), min_size=1, max_size=6)


@given(small, small)
def test_probability_of_improvement_is_a_count_over_pairs(a, b):
    pairs = [1.0 if y < x else 0.5 if y == x else 0.0 for x in a for y in b]
    assert statistics.probability_of_improvement(a, b) == pytest.approx(sum(pairs) / len(pairs))


@given(
    st.lists(st.integers(0, 5), min_size=1, max_size=20), st.lists(st.integers(-1, 6), min_size=1)
)
def test_profile_is_the_share_of_values_above_each_threshold(values, thresholds):
    found = statistics.profile(values, thresholds)
    shares = [sum(v > t for v in values) / len(values) for t in thresholds]
    np.testing.assert_allclose(found, shares, atol=1e-15)


def test_mean_difference_is_welchs_interval():
    rng = np.random.default_rng(5)
    a, b = rng.normal(size=8), rng.normal(1.0, 3.0, size=11)
    found = statistics.mean_difference(a, b)
    expected = scipy.stats.ttest_ind(b, a, equal_var=False).confidence_interval(0.95)
    assert (found.low, found.high) == (expected.low, expected.high)
    assert (found.value, found.kind, found.runs) == (pytest.approx(b.mean() - a.mean()), "t", 8)
    for level in (0.5, 0.95):
        expected = scipy.stats.ttest_1samp(a, 0).confidence_interval(level)
        found = statistics.mean_interval(a, level)
        assert (found.low, found.high) == (expected.low, expected.high)
    few = statistics.mean_difference(a[:4], b)
    assert (few.low, few.high, few.kind, few.runs) == (None, None, "range", 4)
    same = statistics.mean_difference([1.0] * 5, [3.0] * 5)
    assert (same.value, same.low, same.high) == (2.0, 2.0, 2.0)


def test_the_bootstrap_draws_each_task_on_its_own():
    """Two tasks with opposite values: if runs were drawn for both together, the mean would always
    be 0."""
    values = np.array([[k, -k] for k in range(-4, 5)], dtype=float)
    found = statistics.bootstrap(lambda runs: runs.mean(), values, rng=np.random.default_rng(0))
    assert found.low < -0.5
    assert found.high > 0.5
    few = statistics.bootstrap(statistics.iqm, [1, 2, 3, 4], rng=np.random.default_rng(0))
    assert (few.low, few.high, few.kind) == (None, None, "range")


SAME_TASKS = "the same tasks, got 2 and 1"
BAD = {
    "one run": (lambda: permutation_test([1], [1, 2], rng=RNG), "need 2 runs each, got 1 and 2"),
    "margin": (lambda: equivalence_test([1, 2], [1, 2], 0, rng=RNG), "margin must be above 0"),
    "p": (lambda: holm([0.5, 1.5]), r"p_values must be finite and in \[0, 1\]"),
    "empty": (lambda: statistics.mean_interval([]), "values must have at least one value"),
    "NaN": (lambda: statistics.iqm([1.0, math.nan]), "values must be finite, got nan"),
    "level": (lambda: statistics.mean_interval([1, 2], level=95), r"level must be in \(0, 1\)"),
    "count": (lambda: statistics.share(11, 10), "count must be at most runs, got 11 of 10"),
    "tasks": (lambda: statistics.probability_of_improvement([[1, 2]], [[1]]), SAME_TASKS),
    "shape": (lambda: statistics.iqm(np.zeros((2, 2, 2))), r"\[runs\] or \[runs, tasks\]"),
}


@pytest.mark.parametrize(("call", "message"), BAD.values(), ids=BAD)
def test_bad_input_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call()


@pytest.mark.parametrize("wrong", [None, 0])
def test_a_random_generator_is_needed(wrong):
    with pytest.raises(TypeError, match="rng must be a numpy"):
        statistics.bootstrap(statistics.iqm, [1, 2], rng=wrong)
    with pytest.raises(TypeError, match="rng must be a numpy"):
        permutation_test([1, 2], [1, 2], rng=wrong)


def welch(first, second):
    """Return Welch's |t| of the sum of the tasks' differences, from exact fractions.

    first, second: the values of the runs, a list for each task.
    """
    gap, spread = Fraction(0), Fraction(0)
    for a, b in zip(first, second, strict=True):
        gap += Fraction(sum(a), len(a)) - Fraction(sum(b), len(b))
        spread += sum(variance(map(Fraction, of)) / len(of) for of in (a, b))
    if spread == 0:
        return math.inf if gap else 0.0
    return abs(gap) / math.sqrt(spread)


@given(st.data(), st.integers(1, 2))
def test_permutation_test_is_the_count_over_all_divisions(data, tasks):
    """Brute force over the divisions of the runs within each task, with Welch's t from fractions;
    values that differ by rounding count as ties."""
    n, m = (data.draw(st.integers(2, 5 - tasks)) for _ in "ab")
    of_task = st.lists(st.integers(0, 3), min_size=n + m, max_size=n + m)
    values = data.draw(st.lists(of_task, min_size=tasks, max_size=tasks))
    observed = welch([of[:n] for of in values], [of[n:] for of in values])
    extreme = []
    for chosen in itertools.product(itertools.combinations(range(n + m), n), repeat=tasks):
        pairs = list(zip(values, chosen, strict=True))
        one = [[of[k] for k in some] for of, some in pairs]
        other = [[of[k] for k in range(n + m) if k not in some] for of, some in pairs]
        extreme.append(welch(one, other) >= observed * (1 - 1e-9))
    columns = np.transpose(values)
    found = permutation_test(columns[:n], columns[n:], rng=RNG)
    assert found == pytest.approx(np.mean(extreme))


def test_three_runs_on_each_of_four_tasks_decide():
    """Of the 20 divisions of each task's runs, one puts all of the first set below the second and
    one all above. The equivalence test is one-sided: its most extreme division is one of 20⁴."""
    base = np.add.outer([1.0, 2.0, 3.0], [0.0, 100.0, 200.0, 300.0])
    assert permutation_test(base, base + 10, rng=RNG) == pytest.approx(2 / 20**4)
    assert permutation_test(base[:, :1], base[:, :1] + 10, rng=RNG) == pytest.approx(2 / 20)
    assert equivalence_test(base, base, 10, rng=RNG) == pytest.approx(1 / 20**4)


def test_many_runs_on_many_tasks_are_permuted_at_random():
    """Against the normal distribution, to which sums of ten tasks' differences are close."""
    rng = np.random.default_rng(0)
    means = np.arange(10.0) ** 2
    a, b = rng.normal(means, size=(20, 10)), rng.normal(means + 0.15, size=(25, 10))
    gap = (a.mean(axis=0) - b.mean(axis=0)).sum()
    error = math.sqrt((a.var(axis=0, ddof=1) / 20 + b.var(axis=0, ddof=1) / 25).sum())
    expected = 2 * scipy.stats.norm.sf(abs(gap / error))
    assert 0.01 < expected < 0.5
    assert permutation_test(a, b, rng=rng) == pytest.approx(expected, abs=0.015)


def by_scipy(a, b, extreme=lambda t: t):
    """Return the exact p of Welch's t. extreme: a function of t whose large values count."""

    def t(x, y, axis):
        return extreme(scipy.stats.ttest_ind(x, y, axis=axis, equal_var=False).statistic)

    options = {"permutation_type": "independent", "alternative": "greater", "n_resamples": np.inf}
    return scipy.stats.permutation_test((a, b), t, vectorized=True, **options).pvalue


@pytest.mark.parametrize(("runs", "others"), [(6, 5), (4, 9), (9, 8)])
def test_permutation_test_against_scipy(runs, others):
    """Without ties the exact p is equal, also far from 0, where the mean is 1e9 deviations."""
    rng = np.random.default_rng(runs)
    a, b = rng.normal(size=runs), rng.lognormal(size=others)

    expected = by_scipy(a, b, np.abs)
    assert permutation_test(a, b, rng=rng) == pytest.approx(expected, rel=1e-9)
    far = 1e6 + 1e-3 * a, 1e6 + 1e-3 * b
    assert permutation_test(*far, rng=rng) == pytest.approx(expected, abs=2e-3)


def test_equivalence_is_two_one_sided_tests_by_scipy():
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=7), rng.normal(0.3, size=6)
    expected = max(by_scipy(x, y) for x, y in ((b + 2.0, a), (a + 2.0, b)))
    assert 0.001 < expected < 0.2
    found = equivalence_test(a, b, 2.0, rng=rng)
    assert found == pytest.approx(expected, rel=1e-9)


def test_holm_by_hand():
    """The sorted .01, .02, .04 are multiplied by 3, 2 and 1; none is below the one before or
    above 1."""
    np.testing.assert_allclose(holm([0.04, 0.01, 0.02]), [0.04, 0.03, 0.04])
    np.testing.assert_allclose(holm([0.9, 0.8]), [1.0, 1.0])
