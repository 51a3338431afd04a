"""StreakCost and LongestStreak for gymnasium: streaks as costs, for any environment and algorithm
that limits cost."""

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
    that an algorithm that limits cost limits streaks as well; info["plain_cost"] is the cost as it
    was. What an agent is judged by is the plain cost: `RecordCosts` and `EMCCCallback` record it,
    inside or outside of this wrapper.
    observe: append k / scale, which is 0 after a safe step, to the observation, so that the task
    stays Markov: without it the cost depends on what the agent cannot see. The observation space
    must then be a flat Box. scale: cost steps that make the observation 1.
    threshold: a step whose cost exceeds it is a cost step.
    In a vector environment info["cost"] and info["plain_cost"] are [num_envs] arrays of the step
    just taken, in every autoreset mode, as rewards are; so are those in info["final_info"].
    TypeError: no gymnasium environment, or no flat Box of floats to append to. ValueError: weight
    below 0, scale not above 0, a bad threshold, a vector environment without an autoreset mode, a
    cost that is negative or not finite. KeyError: a step without a cost. RuntimeError: a step after
    an episode's end without a reset.
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

    info["longest_streak"] is m, the steps of the episode's longest streak so far, and
    info["record_cost"] is 1 in a step that makes it longer than before and than `above`, 0 in any
    other. With L the episode's longest streak, the record costs add up to `max(L - above, 0)`, and
    so to L with `above` 0: an algorithm that limits the cost of an episode limits L, in steps. The
    mean of the worst share α of episodes, CVaR_α(L), is the least `above + E[sum] / α` of all
    `above`; the (1 - α) quantile of L attains it (Rockafellar & Uryasev 2000, theorem 1).
    observe: append k / scale and m / scale to the observation, k being the steps of the streak so
    far, 0 after a safe step: record costs depend on both. The observation space must then be a flat
    Box. scale: cost steps that make either number 1.
    cost: key of info. That of any other than "cost" has info["longest_streak_NAME"] and
    info["record_NAME"]: for several costs there is a wrapper around a wrapper.
    threshold: a step whose cost exceeds it is a cost step.
    In a vector environment both are [num_envs] arrays of the step just taken, in every autoreset
    mode, as rewards are; so are those in info["final_info"].
    TypeError: no gymnasium environment, or no flat Box of floats to append to. ValueError: above no
    whole number or below 0; otherwise as `StreakCost`, as are KeyError and RuntimeError.
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
    """The state is k, the steps of the streak so far."""

    weight: float
    scale: float | None
    threshold: float
    start = (0,)

    @property
    def bounds(self) -> Bounds:
        """k / scale, unless there is none."""
        return () if self.scale is None else ((0.0, np.inf),)

    def after(self, state: Numbers, cost: Numbers) -> tuple[Numbers, dict[str, Numbers]]:
        """The weighted cost beside the plain one."""
        streak = np.where(exceed(cost, self.threshold), state[:, 0] + 1, 0)
        return streak[:, None], {"cost": weighted(cost, streak, self.weight), "plain_cost": cost}

    def shown(self, state: Numbers) -> Numbers:
        """In the unit of an observation."""
        return state / self.scale


@dataclass(frozen=True)
class Longest(Augmentation):
    """The state is k and m, the steps of the streak and of the longest streak so far."""

    above: int = 0
    cost: str = "cost"
    scale: float | None = 20.0
    threshold: float = 0.0
    start = (0, 0)

    @property
    def bounds(self) -> Bounds:
        """k / scale and m / scale, unless there is no scale."""
        return () if self.scale is None else ((0.0, np.inf), (0.0, np.inf))

    def after(self, state: Numbers, cost: Numbers) -> tuple[Numbers, dict[str, Numbers]]:
        """The longest streak and the record cost."""
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
    """Key of a cost's record cost in the info."""
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
