"""A policy against the one that took an epoch's steps: surrogate objectives and KL divergence."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from agents.lockstep.compiling import compiled
from agents.on_policy.gaussian import Gaussian
from agents.on_policy.packing import blocks
from agents.on_policy.state import Epoch, Nets


class Block(NamedTuple):
    """Steps of an epoch, with the distribution of the policy that took them."""

    observation: Tensor
    """[R, BLOCK, observation size]"""
    action: Tensor
    """[R, BLOCK, A]"""
    weight: Tensor
    """[R, BLOCK]"""
    gains: Tensor
    """[R, 2, BLOCK]: advantages of the objective and of the first cost"""
    old: Gaussian
    """The policy before its step."""
    old_log_prob: Tensor
    """[R, BLOCK]"""


def blocks_of(nets: Nets, actor: Tensor, epoch: Epoch, objective: Tensor) -> list[Block]:
    """The epoch's steps under the policy that took them; objective: advantages [R, B]."""
    first = epoch.cost_advantage[:, 0]
    columns = (epoch.observation, epoch.action, epoch.weight, objective, first)
    found = []
    for observation, action, weight, of_objective, of_cost in blocks(*columns):
        old = nets.actor.distribution(actor, observation)
        gains = torch.stack((of_objective, of_cost), dim=1)
        found.append(Block(observation, action, weight, gains, old, old.log_prob(action)))
    return found


@compiled
def compared_in(nets: Nets, actor: Tensor, block: Block) -> tuple[Tensor, Tensor]:
    """A block's part of the sums of `compared`."""
    policy = nets.actor.distribution(actor, block.observation)
    held = block.weight > 0  # elsewhere a sharp policy may give infinity, and 0 · ∞ is NaN
    change = torch.where(held, policy.log_prob(block.action) - block.old_log_prob, 0.0)
    weighted = (block.weight * change.exp())[:, None] * block.gains
    divergence = torch.where(held, block.old.kl(policy), 0.0)
    return weighted.sum(dim=-1), (block.weight * divergence).sum(dim=-1)


def compared(nets: Nets, actor: Tensor, steps: list[Block]) -> tuple[Tensor, Tensor]:
    """A policy against the one before: `E[π(a|s) / π_old(a|s) · A]` for the objective and the first
    cost, [R, 2], and the mean KL divergence from the old to the new one, [R]."""
    surrogates, kl = torch.zeros(len(actor), 2), torch.zeros(len(actor))
    for block in steps:
        of_block, kl_of_block = compared_in(nets, actor, block)
        surrogates, kl = surrogates + of_block, kl + kl_of_block
    return surrogates, kl
