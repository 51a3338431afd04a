"""The critics of the on-policy families: their values, and how they follow their targets."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from agents.lockstep import tree
from agents.lockstep.adam import Moments, adam
from agents.lockstep.compiling import compiled
from agents.on_policy.state import Epoch, Nets, OnPolicyState


@compiled
def values(nets: Nets, critics: Tensor, observation: Tensor) -> Tensor:
    """Values of all critics of each run at observations [R, B, critic inputs]: [R, 1 + C, B]."""
    (runs, batch, width), count = observation.shape, critics.shape[1]
    inputs = observation[:, None].expand(runs, count, batch, width)
    inputs = inputs.reshape(runs * count, batch, width)
    return nets.critic.forward(critics.flatten(0, 1), inputs).view(runs, count, batch)


def critic_step(
    nets: Nets, config: Any, state: OnPolicyState, epoch: Epoch, rows: Tensor, weight: Tensor
) -> tuple[OnPolicyState, Tensor]:
    """One Adam step of all critics on half the mean squared error of a minibatch.

    rows, weight: [R, B]. A run without rows in it waits. Returns the new state and the losses,
    [R, 1 + C].
    """
    run = torch.arange(len(rows))[:, None]
    observation = epoch.observation[run, rows]
    targets = epoch.value_targets
    target = targets.gather(2, rows[:, None].expand(-1, targets.shape[1], -1))
    critics, moments, losses = critics_update(
        nets, config, state.critics, state.critic_moments, observation, target, weight
    )
    return state._replace(critics=critics, critic_moments=moments), losses


@compiled
def critics_update(
    nets: Nets,
    config: Any,
    critics: Tensor,
    moments: Moments,
    observation: Tensor,
    target: Tensor,
    weight: Tensor,
) -> tuple[Tensor, Moments, Tensor]:
    """`critic_step` on the rows that it fetched."""

    def loss(critics: Tensor) -> tuple[Tensor, Tensor]:
        error = values(nets, critics, observation) - target
        parts = 0.5 * (weight[:, None] * error * error).sum(dim=-1)
        return parts.sum(), parts.detach()

    gradient, parts = torch.func.grad(loss, has_aux=True)(critics)
    stepped, followed = adam(critics, gradient, moments, config.learning_rate)
    present = weight[:, 0] > 0
    stepped = torch.where(present[:, None, None], stepped, critics)
    return stepped, tree.select(present, followed, moments), parts
