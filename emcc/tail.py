"""The mean of the highest values: EMCC with a risk level, and the CVaR of cost returns."""

import math
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from emcc.arrays import as_number, as_vector

TIES = ("all", "split")


def emcc(mcc_values: ArrayLike, alpha: float = 1.0, ties: str = "all") -> float:
    """Expected maximum consecutive cost steps, over the share alpha of the worst rollouts.

    mcc_values: [D] MCC of each rollout, in [0, 1] -> float in [0, 1]. alpha 1 is the plain mean.
    ties: how the share of the highest values is read when several rollouts are equal, or when
    alpha * D is not a whole number. "all" is the equation: the mean of all values at or above
    F^-1(1 - alpha), the smallest value v with at least a share 1 - alpha of values <= v. "split"
    is the recipe: the mean of exactly the top share alpha, its last value weighted fractionally.
    Source: equations (emcc) and (emcc_beta_cvar); recipe, steps 4 and 5.
    ValueError: no values, a value outside [0, 1], alpha outside (0, 1], unknown ties.
    """
    return _tail_mean(as_vector(mcc_values, "mcc_values", low=0, high=1), alpha, ties)


def cvar(values: ArrayLike, alpha: float = 0.5, ties: str = "all") -> float:
    """Conditional value at risk: the mean of the share alpha of highest values.

    values: [N] finite numbers, such as the cost returns of evaluation episodes, in their own unit.
    ties: as in `emcc`.
    Source: equations (VaR) and (CVaR): E[z | z >= F^-1(1 - alpha)].
    ValueError: no values, NaN or infinite ones, alpha outside (0, 1], unknown ties.
    """
    return _tail_mean(as_vector(values, "values"), alpha, ties)


def worst(values: ArrayLike, alpha: float = 0.1) -> NDArray[np.bool_]:
    """Mask of the values that `emcc` and `cvar` with ties="all" average: those at or above the
    quantile F^-1(1 - alpha).

    values: [D] finite numbers, such as the MCC of each rollout -> [D] bool. It tells which rollouts
    dominate EMCC. ValueError: no values, NaN or infinite ones, alpha outside (0, 1].
    """
    values = as_vector(values, "values")
    return values >= _quantile(np.sort(values), _as_fraction(alpha) * values.size)


def _tail_mean(values: NDArray[np.float64], alpha: float, ties: str) -> float:
    share = _as_fraction(alpha) * values.size  # how many values the tail has, exactly
    if ties not in TIES:
        raise ValueError(f"ties must be one of {TIES}, got {ties!r}")
    ordered = np.sort(values.astype(np.float64))
    if ties == "all":
        return float(ordered[np.searchsorted(ordered, _quantile(ordered, share)) :].mean())
    whole, rest = divmod(share, 1)
    total = ordered[values.size - whole :].sum()
    if rest:
        total += float(rest) * ordered[values.size - whole - 1]
    return float(total / float(share))


def _quantile(ordered: NDArray, share: Fraction) -> Any:
    """F^-1(1 - alpha): the value of rank ceil((1 - alpha) n), counted from 1."""
    rank = max(ordered.size - math.floor(share), 1)
    return ordered[rank - 1]


def _as_fraction(alpha: float) -> Fraction:
    """The fraction that a float stands for: 1/10 for 0.1, and for 1 - 0.9 as well.

    With floats, (1 - alpha) * n may miss a whole number by a hair, and the tail gains a value.
    """
    alpha = as_number(alpha, "alpha")
    if not 0 < alpha <= 1:
        raise ValueError(f"alpha must be in (0, 1], got {alpha}")
    return Fraction(alpha).limit_denominator(10**9) or Fraction(alpha)
