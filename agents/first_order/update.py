"""The clipped surrogate of PPO, and minibatch steps of Adam up it.

An algorithm adds an `Objective`. Source: Schulman et al. 2017, "Proximal policy optimization
algorithms".
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import torch
from torch import Tensor

from agents.checks import In
from agents.lockstep import tree
from agents.lockstep.adam import Moments, adam
from agents.lockstep.compiling import compiled
from agents.lockstep.lagrange import Multiplier
from agents.on_policy.state import Nets, OnPolicyConfig


@dataclass(frozen=True)
class PPOConfig(OnPolicyConfig):
    """Hyper-parameters of the first-order family.

    The paper has no algorithm of it: the defaults are those of Stable-Baselines3 where they do not
    belong to the on-policy epoch, which is the paper's.
    """

    batch_size: Annotated[int, In(1)] = 64
    """Steps in a minibatch of actor and critics; a multiple of 32. Not in the paper; 64 as in
    Stable-Baselines3 and OmniSafe."""
    actor_iterations: Annotated[int, In(1, 10_000)] = 10
    """Passes of the actor over an epoch's steps. Not in the paper; 10 as in Schulman et al. and
    Stable-Baselines3."""
    clip_range: Annotated[float, In(above=0, high=1)] = 0.2
    """Distance ε from 1 at which the ratio of new and old probability is clipped. Not in the paper;
    0.2 as in Schulman et al."""
    max_gradient_norm: Annotated[float, In(above=0, high=1e12)] = 0.5
    """Norm to which a longer gradient of the actor is scaled. Not in the paper; 0.5 as in
    Stable-Baselines3."""


class Objective(NamedTuple):
    """How an algorithm of the family treats costs."""

    advantage: Callable[[Any, Tensor, Tensor, Tensor], Tensor]
    """(config, reward advantages [R, B], cost advantages [R, C, B], multipliers [R, M]) -> [R, B]:
    the advantages that the policy raises."""
    multipliers: tuple[Multiplier, ...] = ()
    """Each follows `J_C - d` of its cost."""
    costs: int = 1
    """How many costs are learned."""


class Minibatch(NamedTuple):
    """Steps of an epoch that the actor learns from."""

    observation: Tensor
    """[R, B, observation size]"""
    action: Tensor
    """[R, B, A]"""
    weight: Tensor
    """[R, B]: adds up to 1, or to 0 for a run that has no steps in it"""
    advantage: Tensor
    """[R, B]"""
    old_log_prob: Tensor
    """[R, B]: log π_old(a|s)"""


def clipped_surrogate(
    nets: Nets, clip_range: float, actor: Tensor, batch: Minibatch
) -> tuple[Tensor, Tensor]:
    """`E[min(ρ A, clip(ρ, 1 - ε, 1 + ε) A)]`, `ρ = π(a|s) / π_old(a|s)`; equation 7.

    Returns it, [R], and the share of steps whose ratio lies outside the clip range, [R].
    """
    policy = nets.actor.distribution(actor, batch.observation)
    held = batch.weight > 0  # elsewhere a sharp policy may give infinity, and 0 · ∞ is NaN
    change = torch.where(held, policy.log_prob(batch.action) - batch.old_log_prob, 0.0)
    ratio = change.exp()
    clipped = ratio.clamp(1.0 - clip_range, 1.0 + clip_range)
    gain = torch.minimum(ratio * batch.advantage, clipped * batch.advantage)
    outside = ((ratio - 1.0).abs() > clip_range).to(ratio.dtype)
    return (batch.weight * gain).sum(dim=-1), (batch.weight * outside).sum(dim=-1)


@compiled
def actor_step(
    nets: Nets, config: Any, actor: Tensor, moments: Moments, batch: Minibatch
) -> tuple[Tensor, Moments, Tensor]:
    """One Adam step of each run's actor up its clipped surrogate; a run without steps waits.

    Returns actors, moments and the share of clipped steps before the step, [R].
    """

    def loss(actor: Tensor) -> tuple[Tensor, Tensor]:
        surrogate, outside = clipped_surrogate(nets, config.clip_range, actor, batch)
        return -surrogate.sum(), outside.detach()

    gradient, outside = torch.func.grad(loss, has_aux=True)(actor)
    norm = (gradient * gradient).sum(dim=-1, keepdim=True).sqrt()
    gradient = gradient * (config.max_gradient_norm / (norm + 1e-6)).clamp(max=1.0)
    stepped, followed = adam(actor, gradient, moments, config.learning_rate)
    present = batch.weight[:, 0] > 0
    actor = torch.where(present[:, None], stepped, actor)
    return actor, tree.select(present, followed, moments), outside
