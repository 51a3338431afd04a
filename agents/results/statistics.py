"""Means and differences over runs, with their intervals, as numbers.

A measure that one of the runs lacks (None) has no mean over them: it is None too.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from emcc import Difference, Estimate, difference, estimate


def known(values: Sequence[float | None]) -> list[float] | None:
    """The values, or None where there are none or one is unknown."""
    found = [value for value in values if value is not None]
    return found if found and len(found) == len(values) else None


def mean_of(values: Sequence[float | None]) -> Estimate | None:
    """Mean over seeds with its 95 % bootstrap interval where there are several."""
    found = known(values)
    if found is None:
        return None
    # A generator of its own: no number depends on which others are asked for.
    return estimate({"": found}, rng=np.random.default_rng(0))[""]


def difference_of(a: Sequence[float | None], b: Sequence[float | None]) -> Difference | None:
    """Mean over the seeds of `b` less that over `a`, with its interval as in `mean_of`."""
    of_a, of_b = known(a), known(b)
    if of_a is None or of_b is None:
        return None
    return difference(of_a, of_b, rng=np.random.default_rng(0))
