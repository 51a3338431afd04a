"""Adam with a run axis, as a pure function."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

BETA1, BETA2, EPSILON = 0.9, 0.999, 1e-8


class Moments(NamedTuple):
    """Adam's optimiser state of parameters [R, ...]."""

    mean: Tensor
    square: Tensor
    decay1: Tensor
    """β₁ᵗ [R, 1, ...]. Kept as a product, since a power differs in its last bit between lanes."""
    decay2: Tensor
    """β₂ᵗ [R, 1, ...]."""


def no_moments(params: Tensor) -> Moments:
    """The moments before the first step."""
    one = torch.ones([params.shape[0]] + [1] * (params.dim() - 1))
    return Moments(torch.zeros_like(params), torch.zeros_like(params), one, one.clone())


def adam(
    params: Tensor, gradient: Tensor, moments: Moments, learning_rate: float
) -> tuple[Tensor, Moments]:
    """One step down the gradient; all [R, ...]. Source: Kingma & Ba 2015, algorithm 1."""
    mean = moments.mean.lerp(gradient, 1.0 - BETA1)
    square = (BETA2 * moments.square).addcmul(gradient, gradient, value=1.0 - BETA2)
    decay1, decay2 = BETA1 * moments.decay1, BETA2 * moments.decay2
    scale = (square / (1.0 - decay2)).sqrt() + EPSILON
    step = mean / (1.0 - decay1) / scale
    return params - learning_rate * step, Moments(mean, square, decay1, decay2)
