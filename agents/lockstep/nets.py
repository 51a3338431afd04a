"""Multi-layer perceptrons with a run axis: many networks of one shape, computed together.

All parameters of a network lie in one flat vector, padded to a multiple of 32 numbers. So one
optimiser step, one moving average and one checkpoint entry serve all of them, and a run's numbers
fall on the same lanes of the vector units whatever the runs beside it: it trains bit for bit the
same alone as among others.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from agents.errors import UserError

Activation = Literal["tanh", "relu", "silu"]
LANES = 32
SMALL_PRODUCT = 4096
"""Multiplications of a matrix product up to which torch may compute it otherwise than among others:
it hands batches of products to oneDNN by the size of the whole batch."""


def check_batch(batch_size: int) -> None:
    """Refuse a batch_size that is no multiple of 32.

    A run would depend, in its last bits, on the runs beside it: torch computes the remainder of a
    vector otherwise than the vector.
    """
    if batch_size % LANES:
        raise UserError(f"batch_size must be a multiple of {LANES}, got {batch_size}")


class MLP:
    """The shape of a network: its layer sizes, and where each layer lies in the flat vector.

    `MLP((2, 64, 64, 4))` has two inputs, two hidden layers of 64 and four outputs. Hidden layers
    are filled up to multiples of 32 by units without weights, which stay so: their gradients are 0.
    """

    def __init__(self, sizes: Sequence[int], activation: Activation = "tanh") -> None:
        self.sizes = tuple(sizes)
        self.activation: Activation = activation
        n_in, *hidden, n_out = self.sizes
        filled = (n_in, *(-(-n // LANES) * LANES for n in hidden), n_out)
        self._own, self._shapes = _shapes(self.sizes), _shapes(filled)
        counts = [rows * columns for rows, columns in self._shapes]
        self.size = -(-sum(counts) // LANES) * LANES
        """Length of the flat vector, padding included."""
        self._splits = [*counts, self.size - sum(counts)]

    def initial(self, rng: np.random.Generator) -> NDArray[np.float32]:
        """Fresh parameters [size]: uniform in ±1/√(inputs of the layer), as PyTorch draws them."""
        params = np.zeros(self.size, dtype=np.float32)
        for i, layer in enumerate(self.layers(params[None])):
            bound = 1.0 / np.sqrt(self.sizes[i // 2])
            layer[0] = rng.uniform(-bound, bound, layer.size).reshape(layer.shape[1:])
        return params

    def forward(self, params: Tensor, x: Tensor) -> Tensor:
        """The outputs of networks params [N, size] for inputs x [N, B, in]: [N, B, out]."""
        parts = params.split(self._splits, dim=-1)
        # view: torch 2.11 cannot compile unflatten for a GPU.
        layers = [p.view(len(p), *shape) for p, shape in zip(parts, self._shapes, strict=False)]
        # tanh(z) = 2σ(2z) - 1, with the factors folded into the weights: torch's tanh kernel on
        # CPU is six times slower than its sigmoid, and weights are smaller than activations.
        folded = self.activation == "tanh"
        if folded:
            layers = [_without_gradient(*of) for of in zip(layers, self._own, strict=True)]
        for i, (weight, bias) in enumerate(zip(layers[::2], layers[1::2], strict=True)):
            if i > 0 and folded:
                x, bias = torch.sigmoid(x), bias - weight.sum(dim=-2, keepdim=True)
                weight = 2.0 * weight
            elif i > 0:
                x = torch.relu(x) if self.activation == "relu" else torch.nn.functional.silu(x)
            if i < len(self.sizes) - 2 and folded:
                weight, bias = 2.0 * weight, 2.0 * bias
            if weight.shape[-1] == 1:  # slow as a matrix product
                x = (x * weight.transpose(-1, -2)).sum(dim=-1, keepdim=True) + bias
            elif x.shape[-2] * weight[0].numel() <= SMALL_PRODUCT:
                x = (x[..., None] * weight[:, None]).sum(dim=-2) + bias
            else:
                x = torch.baddbmm(bias, x, weight)
        return x

    def forward_each(self, params: Tensor, inputs: Tensor) -> Tensor:
        """One output of each of K networks a run, params [R, K, size], for the same inputs
        [R, B, in]: [R, K, B]."""
        (runs, batch, width), count = inputs.shape, params.shape[1]
        inputs = inputs[:, None].expand(runs, count, batch, width)
        inputs = inputs.reshape(runs * count, batch, width)
        return self.forward(params.flatten(0, 1), inputs).view(runs, count, batch)

    def inputs_of(self, observation: Tensor) -> Tensor:
        """The first of observations [..., at least in]: behind them may stand what others see."""
        return observation[..., : self.sizes[0]].contiguous()

    def layers(self, params: NDArray[np.float32]) -> list[NDArray[np.float32]]:
        """Views of the weights [N, in, out] and biases [N, 1, out] in params [N, size], in turn."""
        parts = np.split(params, np.cumsum(self._splits[:-1]), axis=-1)
        filled = (p.reshape(-1, *shape) for p, shape in zip(parts, self._shapes, strict=False))
        return [p[:, :rows, :columns] for p, (rows, columns) in zip(filled, self._own, strict=True)]


def _without_gradient(layer: Tensor, own: tuple[int, int]) -> Tensor:
    """The layer [N, in, out] with zeros beyond its own shape, which get no gradient.

    With tanh, folded as above, theirs would be a difference of equal sums, 0 but for rounding; and
    Adam makes a whole step of that.
    """
    if layer.shape[1:] == own:
        return layer
    beyond = (0, layer.shape[2] - own[1], 0, layer.shape[1] - own[0])
    return torch.nn.functional.pad(layer[:, : own[0], : own[1]], beyond)


def _shapes(sizes: Sequence[int]) -> list[tuple[int, int]]:
    """Shapes of the weight and the bias of each layer, in turn."""
    return [shape for n_in, n_out in pairwise(sizes) for shape in ((n_in, n_out), (1, n_out))]


def forward_numpy(
    layers: Sequence[NDArray[np.float32]], x: NDArray[np.float32], activation: Activation = "tanh"
) -> NDArray:
    """`MLP.forward` in numpy: for one step of a rollout several times faster than torch.

    layers: of `MLP.layers`; x: [N, B, in] -> [N, B, out].
    """
    for weight, bias in zip(layers[:-2:2], layers[1:-2:2], strict=True):
        x = _IN_NUMPY[activation](x @ weight + bias)
    return x @ layers[-2] + layers[-1]


def _silu(x: NDArray) -> NDArray:
    return x * (0.5 + 0.5 * np.tanh(0.5 * x))  # the sigmoid by tanh cannot overflow


_IN_NUMPY = {"tanh": np.tanh, "relu": lambda x: np.maximum(x, 0), "silu": _silu}


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
