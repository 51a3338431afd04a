"""StreakCost and LongestStreak: Gymnasium wrappers that express streaks as costs, so that any
algorithm that limits cost limits streaks."""

from dataclasses import dataclass
from typing import Any, overload

import gymnasium as gym
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import VectorEnv

from emcc.arrays import as_integers, as_number, exceed
from emcc.augmented import Augmentation, AugmentedEnv, AugmentedVectorEnv, Bounds, Numbers
from emcc.streaks import weighted
from emcc.wrappers import of_kind


def StreakCost(
    env: gym.Env | VectorEnv,
    weight: float = 1.0,
    *,
    observe: bool = True,
    scale: float = 10.0,
    threshold: float = 0.0,
) -> "StreakCostEnv | StreakCostVectorEnv":
    """Wrap an Env or VectorEnv so that long streaks of cost steps cost more than short ones.

    info["cost"] becomes the cost times `1 + weight (k - 1)` at the k-th consecutive cost step, so
    that an algorithm that limits cost limits streaks as well; info["plain_cost"] is the original
    cost. Agents are judged by the plain cost: `RecordCosts` and `EMCCCallback` record it, inside or
    outside of this wrapper.
    observe: append k / scale, which is 0 after a safe step, to the observation, so that the task
    stays Markov: otherwise the cost depends on what the agent cannot see. The observation space
    must then be a flat Box. scale: number of consecutive cost steps that is observed as 1.
    threshold: a step whose cost exceeds it is a cost step.
    In a vector environment, info["cost"] and info["plain_cost"], also in info["final_info"], are
    [num_envs] arrays that describe the step just taken, like the rewards, in every autoreset mode.
    TypeError: not a Gymnasium environment, or no flat Box of floats to append to.
    ValueError: weight below 0, scale not above 0, a bad threshold, a vector environment without an
    autoreset mode, a negative or non-finite cost. KeyError: a step without a cost. RuntimeError: a
    step after an episode's end without a reset.
    """
    weight, threshold = as_number(weight, "weight", 0), as_number(threshold, "threshold", 0)
    kind = of_kind(env, StreakCostEnv, StreakCostVectorEnv)
    return kind(env, weight, _scale(scale) if observe else None, threshold)


@overload
def LongestStreak(env: VectorEnv, *args: Any, **options: Any) -> "LongestStreakVectorEnv": ...
@overload
def LongestStreak(env: gym.Env, *args: Any, **options: Any) -> "LongestStreakEnv": ...
def LongestStreak(
    env: gym.Env | VectorEnv,
    above: int = 0,
    observe: bool = True,
    *,
    cost: str = "cost",
    scale: float = 20.0,
    threshold: float = 0.0,
) -> "LongestStreakEnv | LongestStreakVectorEnv":
    """Wrap an Env or VectorEnv so that the longest streak of an episode is an additive cost.

    info["longest_streak"] is m, the length of the episode's longest streak so far, and
    info["record_cost"] is 1 in a step that makes the running streak longer than m and than `above`,
    0 in any other step. The record costs of an episode add up to `max(L - above, 0)`, where L is
    the episode's longest streak, and so to L if `above` is 0: an algorithm that limits the cost of
    an episode limits L, in steps. CVaR_α(L), the mean over the worst share α of episodes, is the
    minimum of `above + E[sum] / α` over all `above`, attained at the (1 - α) quantile of L
    (Rockafellar & Uryasev 2000, theorem 1).
    observe: append k / scale and m / scale to the observation, where k is the length of the running
    streak, 0 after a safe step: record costs depend on both. The observation space must then be a
    flat Box. scale: value of k or m that is observed as 1.
    cost: key of the cost in info. Any NAME but "cost" gives info["longest_streak_NAME"] and
    info["record_NAME"]: for several costs, nest the wrappers.
    threshold: a step whose cost exceeds it is a cost step.
    In a vector environment both entries, also in info["final_info"], are [num_envs] arrays that
    describe the step just taken, like the rewards, in every autoreset mode.
    TypeError: not a Gymnasium environment, or no flat Box of floats to append to. ValueError: above
    is no whole number or below 0; otherwise as in `StreakCost`, like KeyError and RuntimeError.
    """
    steps, threshold = int(as_integers(above, "above")), as_number(threshold, "threshold", 0)
    if not isinstance(cost, str):
        raise TypeError(f"cost must be a key of info, got {cost!r}")
    kind = of_kind(env, LongestStreakEnv, LongestStreakVectorEnv)
    return kind(env, steps, cost, _scale(scale) if observe else None, threshold)


def _scale(scale: float) -> float:
    if as_number(scale, "scale") <= 0:
        raise ValueError(f"scale must be above 0, got {scale}")
    return float(scale)


@dataclass(frozen=True)
class Weights(Augmentation):
    """The augmentation of `StreakCost`; the state is k, the length of the running streak."""

    weight: float
    scale: float | None
    threshold: float
    start = (0,)

    @property
    def bounds(self) -> Bounds:
        """Bounds of k / scale; () if scale is None."""
        return () if self.scale is None else ((0.0, np.inf),)

    def after(self, state: Numbers, cost: Numbers) -> tuple[Numbers, dict[str, Numbers]]:
        """Return the next state, and the weighted and the plain cost."""
        streak = np.where(exceed(cost, self.threshold), state[:, 0] + 1, 0)
        return streak[:, None], {"cost": weighted(cost, streak, self.weight), "plain_cost": cost}

    def shown(self, state: Numbers) -> Numbers:
        """In the unit of an observation."""
        return state / self.scale


@dataclass(frozen=True)
class Longest(Augmentation):
    """The augmentation of `LongestStreak`; the state is k and m, the lengths of the running and of
    the longest streak."""

    above: int = 0
    cost: str = "cost"
    scale: float | None = 20.0
    threshold: float = 0.0
    start = (0, 0)

    @property
    def bounds(self) -> Bounds:
        """Bounds of k / scale and m / scale; () if scale is None."""
        return () if self.scale is None else ((0.0, np.inf), (0.0, np.inf))

    def after(self, state: Numbers, cost: Numbers) -> tuple[Numbers, dict[str, Numbers]]:
        """Return the next state, and the longest streak and the record cost."""
        before = state[:, 1]
        streak = np.where(exceed(cost, self.threshold), state[:, 0] + 1, 0)
        longest = np.maximum(before, streak)
        record = (streak > np.maximum(before, self.above)).astype(np.float64)
        name = "longest_streak" + f"_{self.cost}" * (self.cost != "cost")
        told = {name: longest, record_name(self.cost): record}
        return np.stack((streak, longest), axis=-1), told

    def shown(self, state: Numbers) -> Numbers:
        """In the unit of an observation."""
        return state / self.scale


def record_name(cost: str) -> str:
    """Return the key of a cost's record cost in the info."""
    return f"record_{cost}"


class StreakCostEnv(AugmentedEnv, RecordConstructorArgs):
    """`StreakCost` of an Env."""

    def __init__(self, env: gym.Env, weight: float, scale: float | None, threshold: float) -> None:
        RecordConstructorArgs.__init__(self, weight=weight, scale=scale, threshold=threshold)
        AugmentedEnv.__init__(self, env, Weights(weight, scale, threshold))


class StreakCostVectorEnv(AugmentedVectorEnv):
    """`StreakCost` of a VectorEnv."""

    def __init__(self, env: VectorEnv, *how: Any) -> None:
        super().__init__(env, Weights(*how))


class LongestStreakEnv(AugmentedEnv, RecordConstructorArgs):
    """`LongestStreak` of an Env."""

    def __init__(
        self, env: gym.Env, above: int, cost: str, scale: float | None, threshold: float
    ) -> None:
        how = {"above": above, "cost": cost, "scale": scale, "threshold": threshold}
        RecordConstructorArgs.__init__(self, **how)
        AugmentedEnv.__init__(self, env, Longest(**how))


class LongestStreakVectorEnv(AugmentedVectorEnv):
    """`LongestStreak` of a VectorEnv."""

    def __init__(self, env: VectorEnv, *how: Any) -> None:
        super().__init__(env, Longest(*how))
