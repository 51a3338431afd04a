"""The first-order family: passes of Adam over an epoch's minibatches."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from agents.first_order.update import FirstOrderConfig, Minibatch, Objective, actor_step
from agents.lockstep import lagrange
from agents.lockstep.adam import no_moments
from agents.on_policy.comparison import blocks_of, compared
from agents.on_policy.learner import OnPolicy
from agents.on_policy.packing import minibatches
from agents.on_policy.state import Epoch, OnPolicyState


class FirstOrder(OnPolicy):
    """The runs of one algorithm of the first-order family."""

    takes = (FirstOrderConfig, Objective)
    improvement_metrics = ("kl", "clipped")
    """Mean KL divergence from the old to the new policy; mean share of steps whose ratio is clipped
    or, without clipping, that lie outside a trust region."""

    def __init__(
        self,
        config: FirstOrderConfig,
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
        old = blocks_of(self.nets, actor, epoch, advantage)
        old_log_prob = torch.cat([block.old_log_prob for block in old], dim=-1)
        limit = getattr(config, "cost_limit", 0.0)
        costs = ((epoch.cost - limit).to(actor.dtype), multipliers)
        clipped, count, run = torch.zeros(runs), torch.zeros(runs), torch.arange(runs)[:, None]
        for k, surrogate in enumerate(rule.surrogates):
            start = blocks_of(self.nets, actor, epoch, advantage) if k else old
            mean = torch.cat([block.old.mean for block in start], dim=1)
            going = torch.ones(runs, 1)
            for _ in range(config.actor_iterations):
                for rows, weight in minibatches(steps, config.batch_size, generators):
                    columns = (epoch.observation, epoch.action, advantage, old_log_prob, mean)
                    observation, action, gain, before, center = (c[run, rows] for c in columns)
                    index = rows[:, None].expand(-1, self.costs, -1)
                    cost_gain = epoch.cost_advantage.gather(2, index)
                    weight = weight * going
                    policy = start[0].old._replace(mean=center)
                    batch = Minibatch(
                        observation, action, weight, gain, before, cost_gain, policy, *costs
                    )
                    stepped = actor_step(self.nets, config, actor, moments, batch, surrogate)
                    actor, moments, outside = stepped
                    clipped, count = clipped + outside, count + (weight[:, 0] > 0)
                if config.kl_stop:
                    _, moved = compared(self.nets, actor, start)
                    going = going * (moved <= config.kl_stop)[:, None]
        _, kl = compared(self.nets, actor, old)
        records = {"kl": kl, "clipped": clipped / count}
        names = lagrange.names(rule.multipliers)
        records |= dict(zip(names, multipliers.unbind(dim=-1), strict=True))
        return state._replace(actor=actor, actor_moments=moments), records
