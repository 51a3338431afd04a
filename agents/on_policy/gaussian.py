"""The policy of the on-policy family: a Gaussian whose deviation does not depend on the state."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from agents.lockstep.nets import LANES, MLP, forward_numpy


class Gaussian(NamedTuple):
    """Distributions of actions."""

    mean: Tensor
    """[R, B, A]"""
    log_std: Tensor
    """[R, 1, A]"""
    std: Tensor
    """[R, 1, A]"""

    def log_prob(self, action: Tensor) -> Tensor:
        """Of actions [R, B, A] that were not clipped -> [R, B]."""
        z = (action - self.mean) / self.std
        return (-0.5 * z * z - self.log_std - 0.5 * math.log(2.0 * math.pi)).sum(dim=-1)

    def kl(self, new: Gaussian) -> Tensor:
        """`KL(self ‖ new)` -> [R, B]."""
        difference = self.mean - new.mean
        spread = self.std * self.std + difference * difference
        ratio = 0.5 * spread / (new.std * new.std)
        return (new.log_std - self.log_std + ratio - 0.5).sum(dim=-1)


class GaussianPolicy(NamedTuple):
    """Where mean and log-std lie in the parameters [R, size]: a network's, then the log-std."""

    net: MLP

    @property
    def size(self) -> int:
        """Length of the parameters, padding included."""
        return self.net.size + -(-self.net.sizes[-1] // LANES) * LANES

    def initial(self, rng: np.random.Generator, log_std: float) -> NDArray[np.float32]:
        """Fresh parameters [size]."""
        params = np.zeros(self.size, dtype=np.float32)
        params[: self.net.size] = self.net.initial(rng)
        params[self.net.size : self.net.size + self.net.sizes[-1]] = log_std
        return params

    def distribution(self, params: Tensor, observation: Tensor) -> Gaussian:
        """At observations [R, B, at least observation size], of which it sees the first."""
        # The exponential is taken of whole rows of lanes: see `nets`.
        log_std, actions = params[:, self.net.size :].contiguous(), self.net.sizes[-1]
        return Gaussian(
            self.net.forward(params[:, : self.net.size], self.net.inputs_of(observation)),
            log_std[:, None, :actions],
            log_std.exp()[:, None, :actions],
        )

    def act(
        self,
        params: NDArray[np.float32],
        observation: NDArray[np.float32],
        noise: NDArray[np.float32] | None,
    ) -> NDArray[np.float32]:
        """`μ + σ·noise` in numpy, not clipped; without noise the deterministic policy's `μ`.

        observation: [R, N, observation size], noise: [R, N, A] -> [R, N, A].
        """
        layers = self.net.layers(params[:, : self.net.size])
        mean = forward_numpy(layers, observation, self.net.activation)
        if noise is None:
            return mean
        log_std = params[:, None, self.net.size : self.net.size + self.net.sizes[-1]]
        return mean + np.exp(log_std) * noise
