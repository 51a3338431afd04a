"""EMCC of the whole training and of its thirds, from the MCC of rollouts; CVaR; the cost rate."""

import math
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from emcc.arrays import as_array, as_count, as_integers, as_number, as_vector, check_range

ALPHA = 0.1
"""Risk level of EMCC by part: the share of a part's rollouts with the highest MCC. Source: the
paper's tables."""
PARTS = {0.33: "0 to 33 %", 0.66: "33 to 66 %", 0.99: "66 to 99 %"}
"""The thirds of training: beta of EMCC_beta, and the range in words. Each third ends at the share
beta of all environment steps and begins where the previous one ends; no third has the last 1 %.
Source: the paper's definition of EMCC_beta."""
TIES = ("split", "all")
"""Ways to read the share alpha when values are equal, the default first: see `emcc`."""


def emcc(mcc_values: ArrayLike, alpha: float = 1.0, ties: str = "split") -> float:
    """Expected maximum consecutive cost steps, over the share alpha of the worst rollouts.

    mcc_values: [D] MCC of each rollout, in [0, 1] -> float in [0, 1]. alpha 1 is the plain mean.
    ties: how to read the share alpha when several rollouts are equal, or when alpha * D is not a
    whole number. "split", which the paper's tables use, is the mean of the alpha * D highest
    values, the lowest of them weighted by the remaining fraction. "all" is the paper's equation to
    the letter: the mean of all values at or above F^-1(1 - alpha), the smallest value v such that
    at least a share 1 - alpha of the values is <= v.
    Source: equations (emcc) and (emcc_beta_cvar); recipe, steps 4 and 5; ties split as in
    Rockafellar and Uryasev 2002, whom the paper cites.
    ValueError: no values, a value outside [0, 1], alpha outside (0, 1], unknown ties.
    """
    return _tail_mean(as_vector(mcc_values, "mcc_values", low=0, high=1), alpha, ties)


def cvar(values: ArrayLike, alpha: float = 0.5, ties: str = "split") -> float:
    """Conditional value at risk: the mean of the share alpha of highest values.

    values: [N] finite numbers, such as the cost returns of evaluation episodes -> in their unit.
    ties: as in `emcc`.
    Source: equations (VaR) and (CVaR), E[z | z >= F^-1(1 - alpha)], which is ties="all".
    ValueError: no values, NaN or infinite values, alpha outside (0, 1], unknown ties.
    """
    return _tail_mean(as_vector(values, "values"), alpha, ties)


def worst(values: ArrayLike, alpha: float = ALPHA, ties: str = "split") -> NDArray[np.bool_]:
    """Return the mask of the values that enter `emcc` and `cvar`, with all ties at the border.

    values: [D] finite numbers, such as the MCC of each rollout -> [D] bool. The mask tells which
    rollouts dominate EMCC. ties: as in `emcc`.
    ValueError: no values, NaN or infinite values, alpha outside (0, 1], unknown ties.
    """
    values = as_vector(values, "values")
    return values >= _tail(values, alpha, ties)[1]


def _tail_mean(values: NDArray[np.float64], alpha: float, ties: str) -> float:
    size, border = _tail(values, alpha, ties)
    if ties == "all":
        return float(values[values >= border].mean(dtype=np.float64))
    # Rockafellar and Uryasev: the border plus the mean excess above it. Written so, the mean of
    # equal values is exact, and rounding lifts no mean above the highest value.
    excess = np.maximum(values.astype(np.float64) - border, 0).sum() / float(size)
    return float(min(border + excess, values.max()))


def _tail(values: NDArray, alpha: float, ties: str) -> tuple[Fraction, Any]:
    """Return the number of values in the tail, maybe fractional, and the lowest of them."""
    if ties not in TIES:
        raise ValueError(f"ties must be one of {TIES}, got {ties!r}")
    size = _as_fraction(alpha) * values.size
    # With "all" the lowest is F^-1(1 - alpha): the value of rank ceil((1 - alpha) n), from 1.
    rank = values.size - math.floor(size) if ties == "all" else values.size - math.ceil(size) + 1
    return size, np.sort(values)[max(rank, 1) - 1]


def _as_fraction(alpha: float) -> Fraction:
    """Return the fraction that a float stands for: 1/10 for 0.1, and for 1 - 0.9 as well.

    In floats, (1 - alpha) * n may miss a whole number by a rounding error, which would add a value
    to the tail.
    """
    alpha = as_number(alpha, "alpha")
    if not 0 < alpha <= 1:
        raise ValueError(f"alpha must be in (0, 1], got {alpha}")
    return Fraction(alpha).limit_denominator(10**9) or Fraction(alpha)


def emcc_by_part(
    mcc_values: ArrayLike,
    start_steps: ArrayLike,
    total_steps: int,
    alpha: float = ALPHA,
    ties: str = "split",
) -> dict[float, float]:
    """EMCC of each third of training -> {0.33: ..., 0.66: ..., 0.99: ...}.

    mcc_values: [D] MCC of each rollout, in [0, 1]; start_steps: [D] environment steps taken
    before each rollout; total_steps: environment steps of the whole training; alpha, ties: as in
    `emcc`, but the default of alpha is 0.1 here and 1 there.
    A rollout belongs to the part in which it starts; the last 1 % of training is in no part.
    Source: equation (emcc_beta_cvar) with beta = 0.33, 0.66, 0.99.
    ValueError: a part without rollouts, a start step outside [0, total_steps), arrays of
    different lengths, or a value as in `emcc`.
    """
    mcc_values = as_vector(mcc_values, "mcc_values", low=0, high=1)
    start_steps = as_integers(as_vector(start_steps, "start_steps"), "start_steps")
    if len(mcc_values) != len(start_steps):
        raise ValueError(f"{len(mcc_values)} mcc_values, but {len(start_steps)} start_steps")
    parts = rollouts_by_part(start_steps, total_steps)
    for part, rollouts in parts.items():
        if not rollouts.any():
            raise ValueError(
                f"no rollout starts in part {part} of {total_steps} training steps; "
                f"they start at steps {start_steps.min()} to {start_steps.max()}"
            )
    return {part: emcc(mcc_values[rollouts], alpha, ties) for part, rollouts in parts.items()}


def rollouts_by_part(
    start_steps: NDArray[np.int64], total_steps: int
) -> dict[float, NDArray[np.bool_]]:
    """Return masks of the rollouts that start in [0, 33 %), [33 %, 66 %) and [66 %, 99 %].

    start_steps: [D] environment steps -> a mask [D] for each of `PARTS`.
    ValueError: a start step outside [0, total_steps).
    """
    total = as_count(total_steps, "total_steps")
    check_range(start_steps, f"start_steps (total_steps {total})", 0, total - 1)
    percent = 100 * start_steps  # of `total`; whole numbers, so that the borders are exact
    ends = [round(100 * part) * total for part in PARTS]
    ends[-1] += 1  # the last part includes its end
    before = [np.False_, *(percent < end for end in ends)]
    return {part: before[k + 1] & ~before[k] for k, part in enumerate(PARTS)}


def cost_rate(costs: ArrayLike, steps: ArrayLike) -> float:
    """Return the cost per step: the sum of all costs of training over the number of all steps.

    costs: costs of steps, or sums over episodes; steps: the number of steps, or the lengths of the
    episodes. Both are numbers or arrays of any shape, and are added up.
    Source: cost rate rho_c in "Existing metrics for SafeRL".
    ValueError: a NaN, infinite or negative cost, a negative or fractional number of steps, no step
    or no cost, several costs that are neither one per length nor one per step.
    """
    costs, steps = as_array(costs, "costs"), as_integers(steps, "steps")
    check_range(costs, "costs", low=0)
    total_steps = int(steps.sum())
    if total_steps == 0:
        raise ValueError("steps add up to 0; at least one step is needed")
    fit = costs.size in (1, steps.size, total_steps) or steps.size == 1
    if not fit or not 0 < costs.size <= total_steps:
        raise ValueError(
            f"{costs.size} costs do not fit {steps.size} lengths of {total_steps} steps in all; "
            "one for each length or for each step is needed"
        )
    return float(costs.sum(dtype=np.float64) / total_steps)
