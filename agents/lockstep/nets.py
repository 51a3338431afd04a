"""Multi-layer perceptrons with a run axis: many networks of one shape, computed together.

All parameters of a network lie in one flat vector: one optimiser step, one moving average and one
checkpoint entry serve all of them. The vector is padded to a multiple of 32 numbers, so that in
PyTorch's sums the numbers of a run fall on the same lanes of the vector units, whatever the runs
beside it.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from agents.lockstep import kernel
from agents.lockstep.backend import array, tensor
from agents.lockstep.descent import LANES
from agents.lockstep.descent import MAY_DIVERGE as MAY_DIVERGE
from agents.lockstep.descent import Moments as Moments
from agents.lockstep.kernel import Activation


class MLP:
    """The shape of a network: its layer sizes, and where each layer lies in the flat vector.

    `MLP((2, 64, 64, 4))` has two inputs, two hidden layers of 64 and four outputs.
    """

    def __init__(self, sizes: Sequence[int], activation: Activation = "tanh") -> None:
        self.sizes = tuple(sizes)
        self.activation: Activation = activation
        used = sum((n_in + 1) * n_out for n_in, n_out in pairwise(self.sizes))
        self.size = -(-used // LANES) * LANES
        """Length of the flat vector, padding included."""

    def initial(self, rng: np.random.Generator) -> NDArray[np.float32]:
        """Return new parameters [size], uniform in ±1/√(inputs of the layer) as PyTorch draws
        them."""
        params = np.zeros(self.size, dtype=np.float32)
        for i, layer in enumerate(self.layers(params[None])):
            bound = 1.0 / np.sqrt(self.sizes[i // 2])
            layer[0] = rng.uniform(-bound, bound, layer.size).reshape(layer.shape[1:])
        return params

    def forward(self, params: Tensor, x: Tensor, share: int = 1) -> Tensor:
        """Return the outputs [N, B, out] of networks params [N, at least size] for inputs x
        [N / share, B, in], each shared by `share` consecutive networks; differentiable in both."""
        return _Network.apply(params, x, self, share)

    def forward_each(self, params: Tensor, inputs: Tensor) -> Tensor:
        """Return the outputs [R, K, B] of K networks per run with one output each, params
        [R, K, size], for the same inputs [R, B, in]."""
        count = params.shape[1]
        return self.forward(params.flatten(0, 1), inputs, count).unflatten(0, (-1, count))[..., 0]

    def layers(self, params: NDArray[np.float32]) -> list[NDArray[np.float32]]:
        """Return views of params [N, size]: weights [N, in, out] and biases [N, 1, out] in turn."""
        return [part for layer in kernel.layers(self.sizes, params) for part in layer]


class _Network(torch.autograd.Function):
    """A network's outputs, with gradients by the kernel's products instead of by PyTorch."""

    @staticmethod
    def forward(ctx: Any, params: Tensor, x: Tensor, net: MLP, share: int) -> Tensor:
        """See `MLP.forward`."""
        numbers = _rows(params), np.ascontiguousarray(x.numpy())
        own = kernel.of(numbers[0])
        if not any(ctx.needs_input_grad):
            return torch.from_numpy(own.values(net, *numbers, share))
        outputs, tape = own.forward(net, *numbers, share)
        ctx.given = net, *numbers, tape, share
        return torch.from_numpy(outputs)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, Tensor | None, None, None]:
        """Return the gradients in parameters and inputs where they are needed."""
        net, params, x, tape, share = ctx.given
        needed = ctx.needs_input_grad[:2]
        of = "p" * needed[0] + "x" * needed[1]
        dy = gradients[0].numpy()
        pulled = kernel.of(params).backward(net, params, x, tape, dy, of, share)
        of_params, of_inputs = (None if g is None else torch.from_numpy(g) for g in pulled)
        if of_inputs is not None and share > 1:
            of_inputs = of_inputs.unflatten(0, (-1, share)).sum(dim=1)
        return of_params, of_inputs, None, None


def _rows(params: Tensor) -> NDArray:
    """Return parameters [N, at least size] with contiguous rows; the rows need not be adjacent."""
    array = params.detach().numpy()
    return array if array.strides[-1] == array.itemsize else np.ascontiguousarray(array)


def forward_numpy(
    layers: Sequence[NDArray[np.float32]], x: NDArray[np.float32], activation: Activation = "tanh"
) -> NDArray:
    """`MLP.forward` in NumPy: for one environment step several times faster than PyTorch.

    layers: from `MLP.layers`; x: [N, B, in] -> [N, B, out].
    """
    for weight, bias in zip(layers[:-2:2], layers[1:-2:2], strict=True):
        x = kernel.ACTIVATIONS[activation](x @ weight + bias)
    return x @ layers[-2] + layers[-1]


def no_moments(params: Tensor | NDArray) -> Moments:
    """Return Adam's moments before the first step."""
    nothing = np.zeros_like(array(params))
    ones = np.ones((len(nothing), *[1] * (nothing.ndim - 1)), nothing.dtype)
    found = (nothing, nothing.copy(), ones, ones.copy())
    return Moments(*(map(tensor, found) if isinstance(params, Tensor) else found))


def adam(
    params: NDArray, gradient: NDArray, moments: Moments, learning_rate: float
) -> tuple[NDArray, Moments]:
    """Take one step down the gradient; all [R, ...]. Source: Kingma & Ba 2015, algorithm 1."""
    stepped, after = params.copy(), Moments(*(part.copy() for part in moments))
    kernel.of(stepped).adam(stepped, gradient, after, learning_rate)
    return stepped, after


MODULES: dict[Activation, type[nn.Module]] = {"tanh": nn.Tanh, "relu": nn.ReLU, "silu": nn.SiLU}


def mlp(layers: Sequence[NDArray[np.float32]], activation: Activation) -> nn.Sequential:
    """Return linear layers with the activation between them.

    layers: weight [in, out] and bias [1, out] of each layer in turn; they are copied.
    """
    modules: list[nn.Module] = []
    for weight, bias in zip(layers[::2], layers[1::2], strict=True):
        linear = nn.Linear(*weight.shape, device="cpu")
        with torch.no_grad():
            linear.weight.copy_(torch.from_numpy(weight.T.copy()))
            linear.bias.copy_(torch.from_numpy(bias[0].copy()))
        modules += [linear, MODULES[activation]()]
    return nn.Sequential(*modules[:-1])
