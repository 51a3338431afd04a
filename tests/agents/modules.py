"""Our flat parameters as PyTorch's own modules, one run at a time: the other side of tests."""

import numpy as np
import torch
from torch import nn

ACTIVATIONS = {"tanh": nn.Tanh, "relu": nn.ReLU, "silu": nn.SiLU}


def linears(net):
    """PyTorch's layers of a network's shape, in float64."""
    return [nn.Linear(a, b).double() for a, b in zip(net.sizes[:-1], net.sizes[1:], strict=True)]


def plain(net):
    """A module of a network's shape, with parameters of its own."""
    between = ACTIVATIONS[net.activation]
    return nn.Sequential(*[part for one in linears(net) for part in (one, between())][:-1])


def module(net, vector):
    """The same network as a module; vector: its parameters, [size]."""
    found = plain(net)
    arrays = net.layers(vector.detach().double().numpy()[None])
    for parameter, array in zip(found.parameters(), arrays, strict=True):
        parameter.data = torch.from_numpy(array[0].T.copy()).reshape(parameter.shape)
    return found


def flat(net, module, of=lambda parameter: parameter.grad):
    """The gradients of a module, or what else `of` gives, in our order, 0 in the padding: [size]."""
    vector = np.zeros((1, net.size))
    for parameter, array in zip(module.parameters(), net.layers(vector), strict=True):
        array[0] = of(parameter).detach().numpy().T
    return torch.from_numpy(vector[0])


def data(parameter):
    """The numbers of a parameter, for `flat`."""
    return parameter.data
