"""From the costs of single steps to the longest streak, and to the MCC of a rollout.

A cost step is a step whose cost exceeds the threshold; a streak is a run of consecutive cost steps.
"""

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from emcc.arrays import as_integers, as_number, as_steps, as_vector, exceed

_BLOCK = 1 << 18  # steps looked at together: their temporaries fit in a processor's cache


def longest_streak(costs: ArrayLike, threshold: float = 0.0) -> int:
    """Length in steps of the longest streak of cost steps in one trajectory.

    costs: [T] cost of each step, finite and >= 0, not necessarily 0/1.
    Source: d_tau^max in equation (mcc).
    ValueError: no step, not 1-D, a NaN, infinite or negative cost, a bad threshold.
    """
    costs = as_vector(costs, "costs", low=0)
    return int(longest_streaks(costs, [costs.size], threshold)[0])


def longest_streaks(
    costs: ArrayLike, lengths: ArrayLike, threshold: float = 0.0
) -> NDArray[np.int64]:
    """Length in steps of the longest streak of each of many trajectories.

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
    """Cost steps and streaks of each of many trajectories.

    costs: [sum of lengths] the trajectories one after another; lengths: [E] steps -> two int64 [E].
    Cost steps divided by streaks is the mean length of a streak.
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
    """The record costs of steps: 1 where a streak becomes longer than any before it in its
    trajectory, and than `above`; 0 elsewhere.

    costs: [T] of one trajectory, or with lengths [E] of many, one after another -> [T]. Those of a
    trajectory with the longest streak L add up to `max(L - above, 0)`: L is an additive cost.
    `LongestStreak` gives them step by step.
    ValueError: as in `longest_streaks`, or above no whole number or below 0.
    """
    above = int(as_integers(above, "above"))
    if lengths is None:
        lengths = [as_vector(costs, "costs", low=0).size]
    found = []
    for streak, begins in _blocks(costs, lengths, threshold):
        # Each trajectory's streaks above all of those before it: the highest so far is its own.
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
    """Blocks of whole trajectories: how many steps the streak has at each step, 0 at a safe one;
    and the steps at which trajectories begin."""
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
        # Steps up to the latest safe one, or up to the trajectory's begin.
        count = np.arange(1, unsafe.size + 1)
        safe = np.where(unsafe, 0, count)
        safe[begins] = begins + ~unsafe[begins]
        yield count - np.maximum.accumulate(safe), begins
        first, start = after, stop


def mcc(trajectories: Iterable[ArrayLike], threshold: float = 0.0) -> float:
    """Maximum consecutive cost steps of one rollout, as a share of the trajectory's length.

    trajectories: the rollout's trajectories, each [T_i] costs of steps -> float in [0, 1].
    A rollout is what is collected between two policy updates. If it cuts an episode, the piece is
    a trajectory of its own: it has its own length, and its streak ends at the cut.
    Equation (mcc): MCC_D = max over tau in D of d_tau^max / l_tau.
    ValueError: a rollout without trajectories, or a trajectory as in `longest_streak`.
    """
    costs, lengths = as_steps(list(trajectories), None, "costs", low=0)
    return float(np.divide(longest_streaks(costs, lengths, threshold), lengths).max())


def streak_bounds(unsafe_steps: ArrayLike, length: ArrayLike) -> tuple[Any, Any]:
    """Least and greatest longest streak that a trajectory with so many cost steps can have.

    unsafe_steps: S, number of cost steps (not their cost); length: T, steps; numbers or arrays.
    low = ceil(S / (T - S + 1)): the T - S safe steps leave T - S + 1 gaps; high = S.
    These bound the longest streak. They are not EMCC: sums of an episode cannot give it, since
    it depends on the order of the steps.
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
    """Costs by their place in a streak: the k-th step of a streak costs `1 + weight (k - 1)` times.

    costs, streak: of any one shape; streak: k at a cost step, 0 elsewhere. A streak of n steps that
    cost 1 each then costs `n + weight n (n - 1) / 2`: one of 8 with weight 1 costs 36, eight of 1
    cost 8.
    """
    factor = 1.0 + weight * np.maximum(np.asarray(streak) - 1, 0)
    return np.asarray(costs, dtype=np.float64) * factor
