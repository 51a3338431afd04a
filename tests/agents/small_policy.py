"""A small policy, built from the memory layout of its parameters with PyTorch's distributions."""

import torch
from torch.distributions import Independent, Normal

from agents.lockstep.nets import MLP
from agents.on_policy.state import GaussianPolicy, Nets

NETS = Nets(GaussianPolicy(MLP((2, 32, 2))), MLP((2, 32, 1)))
SIZE = NETS.actor.size


def normal(*shape, seed=0):
    """Draw standard normal numbers, the same for the same seed."""
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(*shape, generator=generator, dtype=torch.float64)


def policy(params, observation):
    """Return one run's action distribution, from the layout of its parameters [SIZE]."""
    w1, b1, w2, b2, _, log_std, _ = params.split((64, 32, 64, 2, 30, 2, 30))
    mean = torch.tanh(observation @ w1.view(2, 32) + b1) @ w2.view(32, 2) + b2
    return Independent(Normal(mean, log_std.exp().expand_as(mean)), 1)
