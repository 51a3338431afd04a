"""Our flat parameters as PyTorch's own modules, one run at a time: the other side of tests."""

import torch
from torch import nn


def module(net, vector):
    """The same network of nn.Linear layers; vector: its parameters."""
    layers, start = [], 0
    for n_in, n_out in zip(net.sizes[:-1], net.sizes[1:], strict=True):
        linear = nn.Linear(n_in, n_out).double()
        weight = vector[start : start + n_in * n_out].reshape(n_in, n_out)
        linear.weight.data = weight.T.double()
        start += n_in * n_out
        linear.bias.data = vector[start : start + n_out].double()
        start += n_out
        layers += [linear, nn.Tanh()]
    return nn.Sequential(*layers[:-1])


def flat(layers, of=lambda parameter: parameter.grad):
    """The gradients, or what else `of` gives, of a module in the order of our parameters."""
    linears = [layer for layer in layers if isinstance(layer, nn.Linear)]
    parts = [part for layer in linears for part in (of(layer.weight).T.flatten(), of(layer.bias))]
    return torch.cat(parts)
