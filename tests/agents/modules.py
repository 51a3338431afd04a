"""Convert our flat parameters to PyTorch modules, one run at a time, as a reference for tests."""

import numpy as np
import torch
from torch import nn

ACTIVATIONS = {"tanh": nn.Tanh, "relu": nn.ReLU, "silu": nn.SiLU}


def linears(net):
    """Return PyTorch's linear layers in the network's shape, in float64."""
    return [nn.Linear(a, b).double() for a, b in zip(net.sizes[:-1], net.sizes[1:], strict=True)]


def plain(net):
    """Return a module in the network's shape with PyTorch's initial parameters."""
    between = ACTIVATIONS[net.activation]
    return nn.Sequential(*[part for one in linears(net) for part in (one, between())][:-1])


def module(net, vector):
    """Return the network as a module; vector: its parameters, [size]."""
    found = plain(net)
    arrays = net.layers(vector.detach().double().numpy()[None])
    for parameter, array in zip(found.parameters(), arrays, strict=True):
        parameter.data = torch.from_numpy(array[0].T.copy()).reshape(parameter.shape)
    return found


def flat(net, module, of=lambda parameter: parameter.grad):
    """Return a module's gradients, or what `of` gives per parameter, in our flat layout: [size].

    The padding is 0.
    """
    vector = np.zeros((1, net.size))
    for parameter, array in zip(module.parameters(), net.layers(vector), strict=True):
        array[0] = of(parameter).detach().numpy().T
    return torch.from_numpy(vector[0])


def data(parameter):
    """Return a parameter's values, for `flat`."""
    return parameter.data
