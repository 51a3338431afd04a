"""Permutation tests: by brute force, against scipy, and by simulating what they promise."""

import itertools
import math
import statistics
from fractions import Fraction

import numpy as np
import pytest

pytest.importorskip("hypothesis")
pytest.importorskip("scipy", minversion="1.15")
import scipy.stats
from hypothesis import given, settings
from hypothesis import strategies as st

from emcc import equivalence_test, holm, permutation_test

RNG = np.random.default_rng(0)


def margin(rate, simulations):
    """Four standard errors of a share that was counted in so many simulations."""
    return 4 * math.sqrt(rate * (1 - rate) / simulations)


def welch(first, second):
    """|t| of the sum of the tasks' differences, with fractions under the root: a list of each."""
    gap, spread = Fraction(0), Fraction(0)
    for a, b in zip(first, second, strict=True):
        gap += Fraction(sum(a), len(a)) - Fraction(sum(b), len(b))
        spread += sum(statistics.variance(map(Fraction, of)) / len(of) for of in (a, b))
    if spread == 0:
        return math.inf if gap else 0.0
    return abs(gap) / math.sqrt(spread)


@given(
    st.lists(st.integers(0, 3), min_size=2, max_size=4),
    st.lists(st.integers(0, 3), min_size=2, max_size=4),
)
def test_permutation_test_is_the_count_over_all_divisions(a, b):
    """Brute force, with Welch's t in fractions; ties within rounding count as ties."""
    pooled, observed = a + b, welch([a], [b])
    extreme = []
    for chosen in itertools.combinations(range(len(pooled)), len(a)):
        one = [pooled[k] for k in chosen]
        other = [pooled[k] for k in range(len(pooled)) if k not in chosen]
        extreme.append(welch([one], [other]) >= observed * (1 - 1e-9))
    found = permutation_test(a, b, rng=np.random.default_rng(0))
    assert found == pytest.approx(np.mean(extreme))


@settings(max_examples=30)
@given(st.data(), st.integers(2, 3), st.integers(2, 3))
def test_over_tasks_runs_are_divided_within_each(data, n, m):
    """Brute force over the divisions of both tasks."""
    of_task = st.lists(st.integers(0, 3), min_size=n + m, max_size=n + m)
    values = data.draw(st.lists(of_task, min_size=2, max_size=2))
    observed = welch([of[:n] for of in values], [of[n:] for of in values])
    extreme = []
    for chosen in itertools.product(itertools.combinations(range(n + m), n), repeat=2):
        pairs = list(zip(values, chosen, strict=True))
        one = [[of[k] for k in some] for of, some in pairs]
        other = [[of[k] for k in range(n + m) if k not in some] for of, some in pairs]
        extreme.append(welch(one, other) >= observed * (1 - 1e-9))
    columns = np.transpose(values)
    found = permutation_test(columns[:n], columns[n:], rng=RNG)
    assert found == pytest.approx(np.mean(extreme))


def test_three_runs_on_each_of_four_tasks_decide():
    """One division of the 20 of each task has all of the first set below, and one its opposite;
    in the test of equivalence the most extreme one is as likely."""
    base = np.add.outer([1.0, 2.0, 3.0], [0.0, 100.0, 200.0, 300.0])
    assert permutation_test(base, base + 10, rng=RNG) == pytest.approx(2 / 20**4)
    assert permutation_test(base[:, :1], base[:, :1] + 10, rng=RNG) == pytest.approx(2 / 20)
    assert equivalence_test(base, base, 10, rng=RNG) == pytest.approx(1 / 20**4)


def test_many_runs_on_many_tasks_are_permuted_at_random():
    """Sums of ten tasks' differences are close to normal."""
    rng = np.random.default_rng(0)
    means = np.arange(10.0) ** 2
    a, b = rng.normal(means, size=(20, 10)), rng.normal(means + 0.15, size=(25, 10))
    gap = (a.mean(axis=0) - b.mean(axis=0)).sum()
    error = math.sqrt((a.var(axis=0, ddof=1) / 20 + b.var(axis=0, ddof=1) / 25).sum())
    expected = 2 * scipy.stats.norm.sf(abs(gap / error))
    assert 0.01 < expected < 0.5
    assert permutation_test(a, b, rng=rng) == pytest.approx(expected, abs=0.015)


@pytest.mark.parametrize(("runs", "others"), [(6, 5), (4, 9), (9, 8)])
def test_permutation_test_against_scipy(runs, others):
    """Exact ones of values without ties: the same share of all divisions."""
    rng = np.random.default_rng(runs)
    a, b = rng.normal(size=runs), rng.lognormal(size=others)

    def t(x, y, axis):
        found = scipy.stats.ttest_ind(x, y, axis=axis, equal_var=False).statistic
        return np.abs(found)

    options = {"permutation_type": "independent", "alternative": "greater", "n_resamples": np.inf}
    expected = scipy.stats.permutation_test((a, b), t, vectorized=True, **options).pvalue
    assert permutation_test(a, b, rng=rng) == pytest.approx(expected, rel=1e-9)
    assert permutation_test(1e6 + 1e-3 * a, 1e6 + 1e-3 * b, rng=rng) == pytest.approx(
        expected, abs=2e-3
    )


def test_equivalence_is_two_one_sided_tests_by_scipy():
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=7), rng.normal(0.3, size=6)

    def t(x, y, axis):
        return scipy.stats.ttest_ind(x, y, axis=axis, equal_var=False).statistic

    options = {"permutation_type": "independent", "alternative": "greater", "n_resamples": np.inf}
    expected = max(
        scipy.stats.permutation_test((x, y), t, vectorized=True, **options).pvalue
        for x, y in ((b + 2.0, a), (a + 2.0, b))
    )
    assert 0.001 < expected < 0.2
    found = equivalence_test(a, b, 2.0, rng=rng)
    assert found == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("spread", [1.0, 3.0])
def test_sets_that_differ_by_the_margin_are_seldom_called_equivalent(spread):
    rng, simulations = np.random.default_rng(3), 600
    found = [
        equivalence_test(rng.normal(size=6), rng.normal(4.0, spread, size=6), 4.0, rng=rng) <= 0.05
        for _ in range(simulations)
    ]
    assert np.mean(found) <= 0.05 + margin(0.05, simulations) + 0.01


def test_false_positives_over_tasks():
    """Three runs against six, on tasks with other means and spreads; one set has the wider ones."""
    rng, simulations, means = np.random.default_rng(2), 400, [0.0, 10.0, -20.0]
    found = [
        permutation_test(
            rng.normal(means, [1, 2, 3], (3, 3)), rng.normal(means, [1, 1, 1], (6, 3)), rng=rng
        )
        <= 0.05
        for _ in range(simulations)
    ]
    assert np.mean(found) <= 0.05 + margin(0.05, simulations) + 0.01


def test_holm_by_hand():
    """Sorted .01 .02 .04 times 3, 2, 1; none below the one before; at most 1."""
    np.testing.assert_allclose(holm([0.04, 0.01, 0.02]), [0.04, 0.03, 0.04])
    np.testing.assert_allclose(holm([0.9, 0.8]), [1.0, 1.0])


BAD = {
    "one run": (lambda: permutation_test([1], [1, 2], rng=RNG), "need 2 runs each, got 1 and 2"),
    "tasks": (
        lambda: permutation_test([[1, 2], [3, 4]], [[1], [2]], rng=RNG),
        "the same tasks, got 2 and 1",
    ),
    "margin": (lambda: equivalence_test([1, 2], [1, 2], 0, rng=RNG), "margin must be above 0"),
    "p": (lambda: holm([0.5, 1.5]), r"p_values must be finite and in \[0, 1\]"),
}


@pytest.mark.parametrize(("call", "message"), BAD.values(), ids=BAD)
def test_bad_input_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call()


@pytest.mark.parametrize("rng", [0, None])
def test_generators_are_explicit(rng):
    with pytest.raises(TypeError, match="rng must be a numpy"):
        permutation_test([1, 2], [1, 2], rng=rng)
