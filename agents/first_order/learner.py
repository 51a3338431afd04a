"""The first-order family: passes of Adam over an epoch's minibatches."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from agents.first_order.update import Minibatch, Objective, PPOConfig, actor_step
from agents.lockstep import lagrange
from agents.lockstep.adam import no_moments
from agents.on_policy.comparison import blocks_of, compared
from agents.on_policy.learner import OnPolicy
from agents.on_policy.packing import minibatches
from agents.on_policy.state import Epoch, OnPolicyState


class FirstOrder(OnPolicy):
    """The runs of one algorithm of the first-order family."""

    takes = (PPOConfig, Objective)
    improvement_metrics = ("kl", "clipped")
    """Mean KL divergence from the old to the new policy; mean share of clipped steps."""

    def __init__(
        self,
        config: PPOConfig,
        rule: Objective,
        seeds: Sequence[int],
        observation_size: int,
        action_size: int,
    ) -> None:
        super().__init__(config, rule, seeds, observation_size, action_size)
        self._state = self._state._replace(actor_moments=no_moments(self._state.actor))

    def improve(
        self, epoch: Epoch, steps: NDArray[np.int64], generators: list[np.random.Generator]
    ) -> tuple[OnPolicyState, dict[str, Tensor]]:
        """Passes of the actors over the epoch, each in minibatches of an order of its own."""
        config, rule, state = self.config, self.rule, self._state
        actor, moments, runs = state.actor, state.actor_moments, len(self.seeds)
        assert moments is not None
        multipliers = lagrange.values(rule.multipliers, state.multipliers, runs)
        advantages = epoch.reward_advantage, epoch.cost_advantage
        advantage = rule.advantage(config, *advantages, multipliers)
        blocks = blocks_of(self.nets, actor, epoch, advantage)
        old_log_prob = torch.cat([block.old_log_prob for block in blocks], dim=-1)
        clipped, count, run = torch.zeros(runs), torch.zeros(runs), torch.arange(runs)[:, None]
        for _ in range(config.actor_iterations):
            for rows, weight in minibatches(steps, config.batch_size, generators):
                columns = (epoch.observation, epoch.action, advantage, old_log_prob)
                observation, action, gain, before = (column[run, rows] for column in columns)
                batch = Minibatch(observation, action, weight, gain, before)
                actor, moments, outside = actor_step(self.nets, config, actor, moments, batch)
                clipped, count = clipped + outside, count + (weight[:, 0] > 0)
        _, kl = compared(self.nets, actor, blocks)
        records = {"kl": kl, "clipped": clipped / count}
        names = lagrange.names(rule.multipliers)
        records |= dict(zip(names, multipliers.unbind(dim=-1), strict=True))
        return state._replace(actor=actor, actor_moments=moments), records
