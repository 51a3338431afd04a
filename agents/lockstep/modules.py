"""Networks of one run as ordinary modules of PyTorch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from agents.lockstep.nets import Activation

ACTIVATIONS: dict[Activation, type[nn.Module]] = {
    "tanh": nn.Tanh,
    "relu": nn.ReLU,
    "silu": nn.SiLU,
}


def mlp(layers: Sequence[NDArray[np.float32]], activation: Activation) -> nn.Sequential:
    """Linear layers with the activation between them.

    layers: weight [in, out] and bias [1, out] of each layer in turn; they are copied.
    """
    modules: list[nn.Module] = []
    for weight, bias in zip(layers[::2], layers[1::2], strict=True):
        linear = nn.Linear(*weight.shape, device="cpu")
        with torch.no_grad():
            linear.weight.copy_(torch.from_numpy(weight.T.copy()))
            linear.bias.copy_(torch.from_numpy(bias[0].copy()))
        modules += [linear, ACTIVATIONS[activation]()]
    return nn.Sequential(*modules[:-1])
