"""The thirds of training, EMCC of each, and the cost rate."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from emcc.arrays import as_array, as_count, as_integers, as_vector, check_range
from emcc.tail import emcc

ALPHA = 0.1
"""Risk level of EMCC by part: the share of a part's rollouts with the highest MCC. Source: the
paper's tables."""

PARTS = {0.33: "0 to 33 %", 0.66: "33 to 66 %", 0.99: "66 to 99 %"}
"""The thirds of training: beta of EMCC_beta, and the stretch of training in words. Each ends at the
share beta of all environment steps and begins where the one before ends; the last 1 % is in none.
Source: the paper's definition of EMCC_beta."""


def emcc_by_part(
    mcc_values: ArrayLike,
    start_steps: ArrayLike,
    total_steps: int,
    alpha: float = ALPHA,
    ties: str = "all",
) -> dict[float, float]:
    """EMCC of each third of training -> {0.33: ..., 0.66: ..., 0.99: ...}.

    mcc_values: [D] MCC of each rollout, in [0, 1]; start_steps: [D] environment steps taken
    before each rollout; total_steps: environment steps of the whole training; alpha and ties as
    in `emcc`, but alpha is 0.1 by default here and 1 there. A rollout belongs to the part in which
    it starts; the last 1 % is in no part.
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
    return {part: emcc(mcc_values[where], alpha, ties) for part, where in parts.items()}


def rollouts_by_part(
    start_steps: NDArray[np.int64], total_steps: int
) -> dict[float, NDArray[np.bool_]]:
    """Masks of the rollouts that start in each part: [0, 33 %), [33 %, 66 %) and [66 %, 99 %].

    start_steps: [D] environment steps -> for each of `PARTS` a mask [D].
    ValueError: a start step outside [0, total_steps).
    """
    total = as_count(total_steps, "total_steps")
    check_range(start_steps, "start_steps", 0, total - 1)
    percent = 100 * start_steps  # of `total`; whole numbers, so that the borders are exact
    ends = [round(100 * part) * total for part in PARTS]
    masks = [
        (begin <= percent) & (percent < end) for begin, end in zip([0, *ends], ends, strict=False)
    ]
    masks[-1] |= percent == ends[-1]
    return dict(zip(PARTS, masks, strict=True))


def cost_rate(costs: ArrayLike, steps: ArrayLike) -> float:
    """All costs of training divided by all its steps: cost per step.

    costs: costs of steps or sums of episodes; steps: their number, or the lengths of the episodes.
    Both are numbers or arrays of any shape, and are added up.
    Source: cost rate rho_c in "Existing metrics for SafeRL".
    ValueError: a NaN, infinite or negative cost, a negative or fractional number of steps, no step
    or no cost, more costs than steps, several that are neither one for each of several lengths nor
    one for each step.
    """
    costs, steps = as_array(costs, "costs"), as_integers(steps, "steps")
    check_range(costs, "costs", low=0)
    total_steps = int(steps.sum())
    if total_steps == 0:
        raise ValueError("steps add up to 0; at least one step is needed")
    if not 0 < costs.size <= total_steps:
        raise ValueError(f"{total_steps} steps need 1 to {total_steps} costs, got {costs.size}")
    if costs.size > 1 and steps.size > 1 and costs.size not in (steps.size, total_steps):
        raise ValueError(
            f"{costs.size} costs, but {steps.size} lengths of {total_steps} steps in all; "
            "one for each length or for each step is needed"
        )
    return float(costs.sum(dtype=np.float64) / total_steps)
