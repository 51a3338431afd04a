"""Longest streaks, and the MCC of a rollout, from the costs of steps.

A cost step is a step whose cost exceeds the threshold; a streak is a run of consecutive cost steps.
"""

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from emcc.arrays import as_integers, as_number, as_steps, as_vector, exceed

_BLOCK = 1 << 18  # steps per block, so that the temporary arrays fit in the CPU's cache


def longest_streak(costs: ArrayLike, threshold: float = 0.0) -> int:
    """Return the length in steps of the longest streak of cost steps in one trajectory.

    costs: [T] cost of each step, finite and >= 0, not necessarily 0/1.
    Source: d_tau^max in equation (mcc).
    ValueError: no step, not 1-D, a NaN, infinite or negative cost, a bad threshold.
    """
    costs = as_vector(costs, "costs", low=0)
    return int(longest_streaks(costs, [costs.size], threshold)[0])


def longest_streaks(
    costs: ArrayLike, lengths: ArrayLike, threshold: float = 0.0
) -> NDArray[np.int64]:
    """Return the length in steps of the longest streak of each of many trajectories.

    costs: [sum of lengths] the trajectories one after another; lengths: [E] steps -> int64 [E].
    A streak never crosses from one trajectory into the next.
    Source: d_tau^max in equation (mcc).
    ValueError: an empty trajectory, lengths that do not add up to the number of costs, a NaN,
    infinite or negative cost, a bad threshold.
    """
    blocks = _blocks(costs, lengths, threshold)
    return np.concatenate([np.maximum.reduceat(streak, begins) for streak, begins in blocks])


def count_streaks(
    costs: ArrayLike, lengths: ArrayLike, threshold: float = 0.0
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the numbers of cost steps and of streaks of each of many trajectories.

    costs: [sum of lengths] the trajectories one after another; lengths: [E] steps -> two int64 [E].
    The first divided by the second is the mean length of a streak.
    ValueError: as in `longest_streaks`.
    """
    counts = [
        [np.add.reduceat(counted, begins, dtype=np.int64) for counted in (streak > 0, streak == 1)]
        for streak, begins in _blocks(costs, lengths, threshold)
    ]
    cost_steps, streaks = map(np.concatenate, zip(*counts, strict=True))
    return cost_steps, streaks


def record(
    costs: ArrayLike,
    lengths: ArrayLike | None = None,
    above: int = 0,
    threshold: float = 0.0,
) -> NDArray[np.float64]:
    """Return the record costs: 1 at steps where a streak becomes longer than `above` and than any
    earlier streak of the trajectory; 0 elsewhere.

    costs: [T] of one trajectory, or with lengths [E] of many, one after another -> [T]. The record
    costs of a trajectory with longest streak L add up to `max(L - above, 0)`: this makes L an
    additive cost. `LongestStreak` computes the same step by step.
    ValueError: as in `longest_streaks`, or above is no whole number or below 0.
    """
    above = int(as_integers(above, "above"))
    if lengths is None:
        lengths = [as_vector(costs, "costs", low=0).size]
    found = []
    for streak, begins in _blocks(costs, lengths, threshold):
        # Lift each trajectory above all earlier ones: the running maximum is then its own.
        lifted = np.zeros_like(streak)
        lifted[begins] = streak.size + 1
        lifted = np.cumsum(lifted)
        before = np.roll(np.maximum.accumulate(lifted + streak), 1) - lifted
        before[begins] = 0
        found.append((streak > np.maximum(before, above)).astype(np.float64))
    return np.concatenate(found)


def _blocks(
    costs: ArrayLike, lengths: ArrayLike, threshold: float
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Yield blocks of whole trajectories: at each step the length of the running streak, 0 at a
    safe step; and the steps at which trajectories begin."""
    costs = as_vector(costs, "costs", low=0)
    lengths = as_integers(as_vector(lengths, "lengths"), "lengths", low=1)
    if (total := int(lengths.sum())) != costs.size:
        raise ValueError(f"lengths add up to {total} steps, but there are {costs.size} costs")
    threshold = as_number(threshold, "threshold", low=0)
    stops, first, start = np.cumsum(lengths), 0, 0
    while start < total:
        after = max(int(np.searchsorted(stops, start + _BLOCK, side="right")), first + 1)
        stop = int(stops[after - 1])
        unsafe, begins = exceed(costs[start:stop], threshold), stops[first:after] - start
        begins -= lengths[first:after]
        # The running maximum of `safe` counts the steps to the last safe one, or to the start.
        count = np.arange(1, unsafe.size + 1)
        safe = np.where(unsafe, 0, count)
        safe[begins] = begins + ~unsafe[begins]
        yield count - np.maximum.accumulate(safe), begins
        first, start = after, stop


def mcc(trajectories: Iterable[ArrayLike], threshold: float = 0.0) -> float:
    """Return the maximum consecutive cost steps of a rollout, as a share of trajectory length.

    trajectories: the rollout's trajectories, each [T_i] costs of steps -> float in [0, 1].
    A rollout is what is collected between two policy updates. If it cuts an episode, each piece is
    a trajectory with its own length, and a streak ends at the cut.
    Equation (mcc): MCC_D = max over tau in D of d_tau^max / l_tau.
    ValueError: a rollout without trajectories, or a trajectory as in `longest_streak`.
    """
    costs, lengths = as_steps(list(trajectories), None, "costs", low=0)
    return float(np.divide(longest_streaks(costs, lengths, threshold), lengths).max())


def streak_bounds(unsafe_steps: ArrayLike, length: ArrayLike) -> tuple[Any, Any]:
    """Return bounds (low, high) of the longest streak of a trajectory with unsafe_steps cost steps.

    unsafe_steps: S, number of cost steps (not their cost); length: T, steps; numbers or arrays.
    low = ceil(S / (T - S + 1)): the T - S safe steps leave T - S + 1 gaps; high = S.
    They bound the longest streak, but do not give EMCC: that depends on the order of the steps,
    which sums over an episode do not have.
    ValueError: not whole numbers, or not 0 <= S <= T with T >= 1.
    """
    unsafe = as_integers(unsafe_steps, "unsafe_steps")
    length = as_integers(length, "length", low=1)
    if (unsafe > length).any():
        raise ValueError("unsafe_steps must not exceed length")
    low = -(-unsafe // (length - unsafe + 1))
    high = unsafe + np.zeros_like(low)  # the common shape
    return (int(low), int(high)) if low.ndim == 0 else (low, high)


def weighted(costs: ArrayLike, streak: ArrayLike, weight: float) -> NDArray[np.float64]:
    """Return costs weighted by `1 + weight (k - 1)` at the k-th step of a streak.

    costs, streak: arrays of the same shape; streak: k at a cost step, 0 elsewhere. A streak of n
    steps that cost 1 each then costs `n + weight n (n - 1) / 2`: with weight 1, one streak of 8
    steps costs 36, and eight streaks of 1 step cost 8.
    """
    factor = 1.0 + weight * np.maximum(np.asarray(streak, dtype=np.int64) - 1, 0)
    return np.asarray(costs, dtype=np.float64) * factor
