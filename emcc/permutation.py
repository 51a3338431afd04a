"""Permutation tests of two sets of runs, by numpy alone, and the correction for many tests."""

from functools import lru_cache
from itertools import combinations
from math import comb

import numpy as np
from numpy.typing import ArrayLike, NDArray

from emcc.arrays import as_count, as_number, as_two_sets, as_vector, check_generator

MOST_EXACT = 200_000
"""Ways to divide the runs among two sets up to which a permutation test goes through all of them:
10 runs against 10 have 184 756."""
_TIE = 1e-12
"""Statistics that differ by less, by rounding, count as equal."""


def permutation_test(
    first: ArrayLike, second: ArrayLike, *, rng: np.random.Generator, resamples: int = 20_000
) -> float:
    """Return the p value of a two-sided permutation test of equal means, with Welch's t.

    first, second: [runs], two at least each, or [runs, tasks] with the same tasks. Exact, over all
    ways to divide the runs among the two sets, where there are 200 000 at most; otherwise over
    `resamples` random ones. Welch's t keeps the test near its level where the spreads differ too.
    With 3 runs against 3 no p value is below 0.1.

    With tasks it is one test of the means over the tasks. Runs are divided within each task (a
    stratum) alone, and t is the sum of the tasks' differences over its standard error. So few runs
    on several tasks can decide: of 3 against 3 on each of four tasks, p can be 2 / 160 000. The
    values of all tasks must have one unit: EMCC does, returns do not.

    Source: Janssen 1997, "Studentized permutation tests for non-i.i.d. hypotheses and the
    generalized Behrens-Fisher problem"; by strata, Good 2005, "Permutation, Parametric and
    Bootstrap Tests of Hypotheses".
    TypeError: rng is no numpy Generator. ValueError: fewer than two runs, NaN or infinite values,
    other shapes.
    """
    angles = np.abs(_permuted(*as_two_sets(first, second, fewest=2), rng, resamples))
    return float((angles >= angles[0] - _TIE).mean())


def equivalence_test(
    first: ArrayLike,
    second: ArrayLike,
    margin: float,
    *,
    rng: np.random.Generator,
    resamples: int = 20_000,
) -> float:
    """Return the p value of an equivalence test: small if the means differ by less than `margin`.

    The null hypothesis is that they differ by `margin` or more. A large p value of
    `permutation_test` does not show that means are equal; a small one here shows that they differ
    by less than the margin. The value is the larger of the p values of two one-sided permutation
    tests of Welch's t, with one set shifted by the margin. margin: > 0, in the values' unit; the
    other arguments as in `permutation_test`; with tasks it is one test of the means over them.
    Source: Schuirmann 1987 (two one-sided tests), Janssen 1997.
    TypeError: rng is no numpy Generator. ValueError: margin <= 0, and as in `permutation_test`.
    """
    if as_number(margin, "margin") <= 0:
        raise ValueError(f"margin must be above 0, got {margin}")
    a, b = as_two_sets(first, second, fewest=2)
    found = []
    for raised, other in ((b + margin, a), (a + margin, b)):  # raised still, it is not the higher
        angles = _permuted(raised, other, rng, resamples)
        found.append(float((angles >= angles[0] - _TIE).mean()))
    return max(found)


def holm(p_values: ArrayLike) -> NDArray[np.float64]:
    """P values of many tests corrected for their number, in the same order: [tests].

    A test is significant at a level where its corrected p value is at most that level; the chance
    of one or more false ones is then at most the level. Source: Holm 1979, "A simple sequentially
    rejective multiple test procedure".
    ValueError: no values, or one outside [0, 1].
    """
    p = as_vector(p_values, "p_values", low=0, high=1).astype(np.float64)
    order = np.argsort(p, kind="stable")
    corrected = np.empty_like(p)
    corrected[order] = np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1))
    return np.minimum(corrected, 1.0)


def _permuted(
    a: NDArray[np.float64], b: NDArray[np.float64], rng: np.random.Generator, resamples: int
) -> NDArray[np.float64]:
    """Welch's t of divisions of the runs [runs, tasks], of the observed one first, as angles.

    The angle, whose tangent is t |t|, rises with t and is finite where there is no spread.
    """
    check_generator(rng)
    pooled, n, m = np.concatenate((a, b)), len(a), len(b)
    scale = np.ptp(pooled, axis=0).max()
    if scale == 0:
        return np.zeros(1)
    pooled = (pooled - pooled.mean(axis=0)) / scale  # t does not change, sums lose no digits
    exact = comb(n + m, n) ** pooled.shape[1] <= MOST_EXACT
    gap = spread = np.zeros(1)
    for task, values in enumerate(pooled.T):
        if exact:
            chosen = _divisions(n + m, n, half=n == m and task == 0)
        else:
            chosen = _random_divisions(n + m, n, as_count(resamples, "resamples"), rng)
        gaps, spreads = _moments(values, chosen, n, m)
        combine = np.add.outer if exact else np.add  # exact: every division with every other task's
        gap, spread = combine(gap, gaps).ravel(), combine(spread, spreads).ravel()
    angles = np.arctan2(gap * np.abs(gap), spread)
    return np.concatenate((angles, -angles)) if exact and n == m else angles


def _moments(
    values: NDArray[np.float64], chosen: NDArray[np.float64], n: int, m: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Difference of the means of the two sets, and its squared standard error, by division."""
    powers = np.stack((values, values**2), axis=1)
    (sums, squares), (all_sum, all_squares) = (chosen @ powers).T, powers.sum(axis=0)
    others, others_squares = all_sum - sums, all_squares - squares
    spread = np.maximum(squares - sums**2 / n, 0) / (n * (n - 1))
    spread += np.maximum(others_squares - others**2 / m, 0) / (m * (m - 1))
    return sums / n - others / m, spread


def _random_divisions(
    runs: int, of_first: int, resamples: int, rng: np.random.Generator
) -> NDArray[np.float64]:
    """As `_divisions`: the observed one, then random ones."""
    order = np.tile(np.arange(runs), (1 + resamples, 1))
    rng.permuted(order[1:], axis=1, out=order[1:])
    return (order < of_first).astype(np.float64)


@lru_cache(maxsize=2)
def _divisions(runs: int, of_first: int, half: bool) -> NDArray[np.float64]:
    """All ways to choose the first set's runs, a row of ones and zeros each, the first runs first.

    half, where both sets have as many runs: those with the very first run alone. Exchanging the
    sets gives the others, and the opposite t.
    """
    rows = np.array(list(combinations(range(runs), of_first)))
    if half:
        rows = rows[rows[:, 0] == 0]
    chosen = np.zeros((len(rows), runs))
    np.put_along_axis(chosen, rows, 1.0, axis=1)
    return chosen
