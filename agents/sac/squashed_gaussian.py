"""The policy of the SAC family: a Gaussian squashed by tanh into (-1, 1)."""

from __future__ import annotations

import math

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import softplus

LOG_STD = (-20.0, 2.0)
"""Where the logarithm of the standard deviation is clamped."""


def sample(outputs: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
    """Actions and their log-probabilities.

    outputs: mean and log-std of the policy net, [R, B, 2·A]; noise: standard normal, [R, B, A]
    -> [R, B, A] in (-1, 1), [R, B]. `a = tanh(u)`, `u = μ + σ·noise`,
    `log π = log N(u) - Σ log(1 - tanh²u)`. Source: Haarnoja et al. 2018, appendix C.
    """
    mean, log_std = outputs.chunk(2, dim=-1)
    log_std = log_std.clamp(*LOG_STD)
    u = mean + log_std.exp() * noise
    log_normal = -0.5 * noise * noise - log_std - 0.5 * math.log(2.0 * math.pi)
    # log(1 - tanh²u) without the cancellation at large u
    log_slope = 2.0 * (math.log(2.0) - u - softplus(-2.0 * u))
    return torch.tanh(u), (log_normal - log_slope).sum(dim=-1)


def act(outputs: NDArray[np.float32], noise: NDArray[np.float32] | None) -> NDArray[np.float32]:
    """The actions of `sample` in numpy; without noise the deterministic policy's, `tanh(μ)`."""
    half = outputs.shape[-1] // 2
    mean, log_std = outputs[..., :half], outputs[..., half:]
    if noise is None:
        return np.tanh(mean)
    log_std = np.minimum(np.maximum(log_std, LOG_STD[0]), LOG_STD[1])
    return np.tanh(mean + np.exp(log_std) * noise)
