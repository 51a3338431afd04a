"""Rollouts as algorithms learn from them: scaled observations, costs that grow along a streak."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.lockstep.rollout import Rollout
from emcc.streaks import weighted


def learned(rollout: Rollout, config: Any, costs: int) -> Rollout:
    """The rollout as an algorithm learns from it: the first `costs` of its costs; observations
    times `config.input_scale`; with a `config.streak_weight`, costs that grow along a streak, and
    behind the observations each cost's streak so far, in steps, for the critics: see
    `critic_inputs`."""
    scale = input_scale(config)
    scaled = rollout._replace(
        observation=rollout.observation * scale,
        next_observation=rollout.next_observation * scale,
        cost=rollout.cost[..., :costs],
    )
    weight = streak_weight(config)
    if not weight:
        return scaled
    after = streaks(scaled.cost)
    before = np.concatenate([np.zeros_like(after[:1]), after[:-1]])
    return scaled._replace(
        observation=_joined(scaled.observation, before),
        next_observation=_joined(scaled.next_observation, after),
        cost=weighted(scaled.cost, after, weight),
    )


def input_scale(config: Any) -> NDArray[np.float32]:
    """Factors on observations: [] for all of their numbers, or [observation size]."""
    return np.asarray(config.input_scale, np.float32)


def streak_weight(config: Any) -> float:
    """Weight of streaks in the learned cost; 0 for an algorithm that limits no cost."""
    return getattr(config, "streak_weight", 0.0)


def critic_inputs(config: Any, observation_size: int, costs: int) -> int:
    """Numbers that critics see of a state. Where costs grow along a streak they see its length as
    well, without which the learned task would not be Markov; the policy never does."""
    return observation_size + costs * bool(streak_weight(config))


def streaks(costs: NDArray[np.float64]) -> NDArray[np.float64]:
    """Consecutive cost steps up to each step of costs [T, ...], itself included; 0 at safe ones."""
    lengths = np.zeros(costs.shape)
    streak = np.zeros(costs.shape[1:])
    for t, at_step in enumerate(costs):
        streak = np.where(at_step > 0, streak + 1, 0)
        lengths[t] = streak
    return lengths


def _joined(observation: NDArray[np.float32], streak: NDArray[np.float64]) -> NDArray[np.float32]:
    return np.concatenate([observation, streak.astype(np.float32)], axis=-1)
