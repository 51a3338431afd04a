"""Hyper-parameters, networks and state of the on-policy families."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from agents.checks import In, Settings
from agents.lockstep import lagrange
from agents.lockstep.backend import tensor
from agents.lockstep.descent import LANES
from agents.lockstep.lagrange import Multiplier, State
from agents.lockstep.nets import (
    MLP,
    Activation,
    Moments,
    forward_numpy,
    no_moments,
)
from agents.lockstep.noise import Purpose, stream
from agents.lockstep.normalizer import InputConfig, Inputs
from agents.lockstep.rollout import Policy, critic_inputs


class Gaussian(NamedTuple):
    """Gaussian distributions of actions."""

    mean: Tensor
    """[R, B, A]"""
    log_std: Tensor
    """[R, 1, A]"""
    std: Tensor
    """[R, 1, A]"""

    def log_prob(self, action: Tensor) -> Tensor:
        """Return the log density of unclipped actions, [R, B, A] -> [R, B]."""
        z = (action - self.mean) / self.std
        return (-0.5 * z * z - self.log_std - 0.5 * math.log(2.0 * math.pi)).sum(dim=-1)

    def kl(self, new: Gaussian) -> Tensor:
        """Return `KL(self ‖ new)`, [R, B]."""
        difference = self.mean - new.mean
        spread = self.std * self.std + difference * difference
        ratio = 0.5 * spread / (new.std * new.std)
        return (new.log_std - self.log_std + ratio - 0.5).sum(dim=-1)


class GaussianPolicy(NamedTuple):
    """Layout of a policy's parameters [R, size]: those of the mean's network, then the log-std."""

    net: MLP

    @property
    def size(self) -> int:
        """Number of parameters, padding included."""
        return self.net.size + -(-self.net.sizes[-1] // LANES) * LANES

    @property
    def log_std(self) -> slice:
        """Slice of the parameters that holds the log-std."""
        return slice(self.net.size, self.net.size + self.net.sizes[-1])

    def initial(self, rng: np.random.Generator, log_std: float) -> NDArray[np.float32]:
        """Return new parameters [size]."""
        params = np.zeros(self.size, dtype=np.float32)
        params[: self.net.size] = self.net.initial(rng)
        params[self.log_std] = log_std
        return params

    def distribution(self, params: Tensor, observation: Tensor) -> Gaussian:
        """Return the distribution at observations [R, B, at least observation size]; what lies
        behind the observation, only for critics, is ignored."""
        # The exponential is computed for whole rows of lanes: see `nets`.
        log_std, actions = params[:, self.net.size :].contiguous(), self.net.sizes[-1]
        return Gaussian(
            self.net.forward(params[:, : self.net.size], observation[..., : self.net.sizes[0]]),
            log_std[:, None, :actions],
            log_std.exp()[:, None, :actions],
        )

    def acting(self, params: NDArray[np.float32], inputs: Inputs) -> Policy:
        """Return the policy with these parameters in NumPy; it takes the task's observations."""
        std = np.exp(params[:, None, self.log_std])
        layers = self.net.layers(params[:, : self.net.size])
        return functools.partial(_act, layers, self.net.activation, std, inputs)


def _act(
    layers: Sequence[NDArray[np.float32]],
    activation: Activation,
    std: NDArray[np.float32],
    inputs: Inputs,
    observation: NDArray[np.float32],
    noise: NDArray[np.float32] | None,
) -> NDArray[np.float32]:
    """Return actions `μ + σ·noise`, not clipped; without noise `μ`, the deterministic policy's.

    observation: [R, N, observation size]; noise: [R, N, A] -> [R, N, A].
    """
    mean = forward_numpy(layers, inputs(observation), activation)
    return mean if noise is None else mean + std * noise


@dataclass(frozen=True)
class OnPolicyConfig(InputConfig):
    """Hyper-parameters of all on-policy algorithms; a family adds its `batch_size`.

    The defaults are the paper's (table HP_Circle2D).
    """

    discount: Annotated[float, In(0, 1)] = 0.99
    """Discount factor γ of rewards and costs, in [0, 1]. Paper: 0.99."""
    gae_lambda: Annotated[float, In(0, 1)] = 0.95
    """Weight λ of longer returns in advantages (GAE), in [0, 1]. Paper: 0.95."""
    episodes: Annotated[int, In(1, 10_000)] = 10
    """Whole episodes per epoch. Paper: 10; 20 on SafetyPointCircle1."""
    learning_rate: Annotated[float, In(above=0, high=1)] = 3e-4
    """Adam's step size. Paper: 3e-4 for the critics."""
    critic_iterations: Annotated[int, In(1, 10_000)] = 10
    """Passes of the critics over an epoch's environment steps. Paper: 10."""
    hidden: Annotated[tuple[int, ...], In(1, 65_536)] = (64, 64)
    """Sizes of the hidden layers of actor and critics. Paper: 64, 64."""
    activation: Activation = "tanh"
    """Activation function of the hidden layers. Not specified in the paper; tanh."""
    input_scale: Annotated[float | tuple[float, ...], In(1e-6, 1e6)] = 1.0
    """Factor by which observations are multiplied before the networks, or one factor for each
    number of an observation. Small tanh networks are smooth: observations in [-1, 1] whose details
    matter need a larger factor. Not in the paper; 1: unchanged."""
    normalize_observations: bool = False
    """Whether networks see standardised observations: each number minus its mean, divided by its
    standard deviation, clipped to ±10; both are of all observations of the run in earlier epochs.
    Not in the paper; in OmniSafe by default."""
    initial_log_std: Annotated[float, In(-20, 20)] = 0.0
    """Initial logarithm of the policy's standard deviation. Not specified in the paper; 0 as in
    Stable-Baselines3."""
    time_limit: Literal["bootstrap", "terminal"] = "bootstrap"
    """Whether to bootstrap at the time limit. Not specified in the paper."""


@dataclass(frozen=True)
class EpisodeCostLimit(Settings):
    """The constraint of the on-policy algorithms that have one."""

    limited_cost = "undiscounted cost of an episode"  # in words, for tables
    cost_limit: Annotated[float, In(0, 1e9)] = 25.0
    """Limit d of the undiscounted cost J_C of an episode, mean over an epoch's episodes. Paper: 5
    on Circle2D, 25 on Safety-Gymnasium."""
    streak_weight: Annotated[float, In(0, 1e6)] = 0.0
    """Weight β ≥ 0 of streaks in the cost that is learned and limited: the cost of the k-th
    consecutive cost step is multiplied by `1 + β (k - 1)`, and the critics see k. Records keep the
    plain cost. Not in the paper; 0: none."""


class OnPolicyState(NamedTuple):
    """Everything that an update reads and writes."""

    actor: Tensor
    """[R, actor size]"""
    critics: Tensor
    """[R, 1 + C, critic size]: for the reward and each cost"""
    critic_moments: Moments
    multipliers: tuple[State, ...]
    actor_moments: Moments | None = None
    """None in a family whose actor is not trained by Adam."""


class Nets(NamedTuple):
    """Shapes of the networks."""

    actor: GaussianPolicy
    critic: MLP


def make_nets(config: OnPolicyConfig, observation_size: int, action_size: int, costs: int) -> Nets:
    """Return the networks for flat observations and actions."""
    seen = critic_inputs(config, observation_size, costs)
    return Nets(
        GaussianPolicy(MLP((observation_size, *config.hidden, action_size), config.activation)),
        MLP((seen, *config.hidden, 1), config.activation),
    )


def initial_state(
    nets: Nets, config: Any, multipliers: Sequence[Multiplier], costs: int, seeds: Sequence[int]
) -> OnPolicyState:
    """Return the state before the first update; that of each run depends on its seed alone."""
    streams = [stream(seed, Purpose.PARAMETERS) for seed in seeds]
    actor = np.stack([nets.actor.initial(rng, config.initial_log_std) for rng in streams])
    critics = [[nets.critic.initial(rng) for _ in range(1 + costs)] for rng in streams]
    critics = tensor(np.array(critics))
    states = lagrange.initial(multipliers, config, len(seeds))
    return OnPolicyState(tensor(actor), critics, no_moments(critics), states)
