"""The networks with a run axis against PyTorch's modules, one run at a time."""

import numpy as np
import pytest
import torch
from torch import nn

from agents.lockstep.nets import LANES, MLP, forward_numpy

SIZES = [(2, 64, 64, 4), (4, 64, 64, 1), (3, 5, 2), (7, 1)]


def modules(net, params):
    """For each network nn.Linear layers with its weights, tanh between them."""
    result = []
    for vector in params:
        layers, start = [], 0
        for n_in, n_out in zip(net.sizes[:-1], net.sizes[1:], strict=True):
            linear = nn.Linear(n_in, n_out, dtype=vector.dtype)
            weight = vector[start : start + n_in * n_out].reshape(n_in, n_out)
            start += n_in * n_out
            linear.weight.data = weight.T.clone()
            linear.bias.data = vector[start : start + n_out].clone()
            start += n_out
            layers += [linear, nn.Tanh()]
        result.append(nn.Sequential(*layers[:-1]))
    return result


def parameters(net, n):
    return torch.from_numpy(np.stack([net.initial(np.random.default_rng(i)) for i in range(n)]))


@pytest.mark.parametrize("sizes", SIZES)
def test_forward(sizes):
    net = MLP(sizes)
    params = parameters(net, 5)
    x = torch.randn(5, 9, sizes[0], generator=torch.Generator().manual_seed(0))
    expected = torch.stack([m(xi) for m, xi in zip(modules(net, params), x, strict=True)])
    torch.testing.assert_close(net.forward(params, x), expected, rtol=1e-5, atol=1e-5)
    in_numpy = forward_numpy(net.layers(params.numpy()), x.numpy())
    torch.testing.assert_close(torch.from_numpy(in_numpy), expected, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("sizes", SIZES)
def test_gradient(sizes):
    """Of a sum over networks, in float64, against one backward pass for each module."""
    net = MLP(sizes)
    params = parameters(net, 3).double()
    x = torch.randn(3, 9, sizes[0], generator=torch.Generator().manual_seed(1)).double()
    gradient = torch.func.grad(lambda p: (net.forward(p, x) ** 2).mean(dim=(1, 2)).sum())(params)
    for module, xi, row in zip(modules(net, params), x, gradient, strict=True):
        (module(xi) ** 2).mean().backward()
        parts = []
        for layer in module:
            if isinstance(layer, nn.Linear):
                parts += [layer.weight.grad.T.flatten(), layer.bias.grad]
        expected = torch.cat(parts)
        torch.testing.assert_close(row[: len(expected)], expected, rtol=1e-9, atol=1e-12)
        assert (row[len(expected) :] == 0).all()  # the padding takes no part


def test_flat_vector_is_padded():
    assert MLP((2, 64, 64, 4)).size == 4640  # 2·64 + 64 + 64·64 + 64 + 64·4 + 4 = 4612, to 32s
    assert all(MLP(sizes).size % LANES == 0 for sizes in SIZES)


def test_initial_parameters_are_pytorchs():
    """Uniform in ±1/√(inputs), weights and biases alike."""
    net = MLP((16, 400, 9))
    weight1, bias1, weight2, bias2 = net.layers(net.initial(np.random.default_rng(0))[None])
    for array, bound in ((weight1, 1 / 4), (bias1, 1 / 4), (weight2, 1 / 20), (bias2, 1 / 20)):
        assert np.abs(array).max() <= bound
        assert array.std() == pytest.approx(bound / np.sqrt(3), rel=0.25)
