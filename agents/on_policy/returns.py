"""Generalised advantage estimation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def advantages(
    reward: NDArray[np.floating],
    value: NDArray[np.floating],
    next_value: NDArray[np.floating],
    terminal: NDArray[np.bool_],
    during: NDArray[np.bool_],
    discount: float,
    gae_lambda: float,
) -> NDArray[np.float64]:
    """Advantages of episodes side by side; everything is [T, N].

    `δ_t = r_t + γ V(s_{t+1}) (1 - terminal_t) - V(s_t)`, `A_t = δ_t + γλ A_{t+1}` within an
    episode. next_value: of the observation each step led to, also where a time limit then cut the
    episode off: such a step is not terminal and bootstraps. during: the steps that belong to an
    episode; the others get 0. Works for costs as for rewards.
    Source: Schulman et al. 2016 ("High-dimensional continuous control using GAE"), equation 16.
    """
    delta = reward + discount * np.where(terminal, 0.0, next_value) - value
    result = np.zeros(reward.shape)
    following = np.zeros(reward.shape[1])
    for t in reversed(range(len(reward))):
        following = np.where(during[t], delta[t] + discount * gae_lambda * following, 0.0)
        result[t] = following
    return result
