"""The epoch of on-policy families: whole episodes, an update of the policy, then of the critics."""

from __future__ import annotations

import functools
import operator
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from agents.lockstep import kernel, lagrange, tree
from agents.lockstep.backend import array, tensor
from agents.lockstep.descent import Descent, Squared, orders
from agents.lockstep.nets import Moments
from agents.lockstep.noise import Purpose, normal, steps_of_noise, streams
from agents.lockstep.rollout import Act, Policy, Rollout, learned
from agents.lockstep.streaks import StreakTail
from agents.on_policy.epoch import EpochData, Packing, advantages
from agents.on_policy.state import OnPolicyState, initial_state, make_nets


class OnPolicy(ABC):
    """The runs of one on-policy algorithm; a subclass for each family defines `improve`."""

    improvement_metrics: ClassVar[tuple[str, ...]]
    """Names of the records that `improve` returns for every algorithm of the family."""

    def __init__(
        self,
        config: Any,
        rule: Any,
        seeds: Sequence[int],
        observation_size: int,
        action_size: int,
    ) -> None:
        rule = lagrange.with_streaks(rule, config)
        self.config, self.rule, self.seeds = config, rule, tuple(seeds)
        self.episodes: int = config.episodes
        critics_own = ("critic_loss", *("cost_critic_loss",) * (rule.costs > 0), "std")
        multipliers = lagrange.names(rule.multipliers)
        self.metrics = (*self.improvement_metrics, *critics_own, *multipliers)
        self.action_size, self.costs = action_size, rule.costs
        self.nets = make_nets(config, observation_size, action_size, rule.costs)
        self._state = initial_state(self.nets, config, rule.multipliers, rule.costs, seeds)
        self._normalizer = config.normalizer(len(seeds), observation_size)
        alpha = getattr(config, "streak_alpha", 1.0)
        self._tail = StreakTail(len(seeds), alpha) if alpha < 1 else None

    @abstractmethod
    def improve(
        self, epoch: EpochData, steps: NDArray[np.int64], generators: list[np.random.Generator]
    ) -> tuple[OnPolicyState, dict[str, torch.Tensor]]:
        """Return the state with improved actors, and records [R] by name.

        steps: [R], rows of the epoch that belong to each run, 0 for an inactive run; generators: of
        each run, for the minibatches of this epoch.
        """

    def policy(self) -> Policy:
        """Return the current policy of every run."""
        params = array(self._state.actor).copy()  # updates change it in place
        return self.nets.actor.acting(params, self.config.inputs(self._normalizer))

    def module(self, run: int) -> nn.Module:
        """Return the deterministic policy of a run in PyTorch: observations -> actions."""
        net = self.nets.actor.net
        params = array(self._state.actor)[run : run + 1, : net.size]
        layers = [layer[0] for layer in net.layers(params)]
        return self.config.inputs(self._normalizer).module(run, layers, net.activation)

    def explorer(self, epoch: int, steps: NDArray[np.int64]) -> Act:
        """Return the function that acts in an epoch: the policy with its noise."""
        policy, runs = self.policy(), len(self.seeds)
        shape = (self.episodes, self.action_size)
        noise = steps_of_noise(normal, self.seeds, Purpose.EXPLORATION, epoch, shape)
        return lambda observation: policy(
            observation.reshape(runs, self.episodes, -1), next(noise)
        ).reshape(runs * self.episodes, -1)

    def learn(self, rollout: Rollout, epoch: int, active: NDArray[np.bool_]) -> NDArray:
        """Improve the policy, then the critics; multipliers follow before or after the policy.

        rollout: N = R·E episodes, those of a run beside each other; active: [R], runs that take
        part. Returns the values of `metrics`, [R, metrics]; NaN for inactive runs.
        """
        length = np.where(np.repeat(active, self.episodes), rollout.length, 0)
        rollout = learned(rollout, self.config, self.costs)._replace(length=length)
        packing = Packing(rollout.during, len(self.seeds))
        level = None
        if self._tail:
            rollout, level = self._tail.of(rollout)
        data = self._epoch(rollout, packing)
        if level is not None:  # CVaR's constant term, which belongs to no step
            data.cost[:, -1] += tensor(level)
        generators = streams(self.seeds, Purpose.UPDATE, epoch)
        before = self._state
        self._state = self._followed(before, data, ahead=True)
        state, records = self.improve(data, packing.steps, generators)
        critics, moments = tree.copy((state.critics, state.critic_moments))
        losses = self._fit(critics, moments, data, packing.steps, generators)
        state = state._replace(critics=critics, critic_moments=moments)
        self._state = tree.where(active, self._followed(state, data, ahead=False), before)
        if self._normalizer:
            self._normalizer.count(rollout.observation, rollout.length)
        records["critic_loss"], records["cost_critic_loss"] = losses[:, 0], losses[:, 1:].sum(dim=1)
        records["std"] = self._std()
        columns = np.stack([array(records[name]) for name in self.metrics], axis=-1)
        return np.where(active[:, None], columns, np.nan)

    def _fit(
        self,
        critics: Tensor,
        moments: Moments,
        epoch: EpochData,
        steps: NDArray[np.int64],
        generators: list[np.random.Generator],
    ) -> Tensor:
        """Train the critics in place, in passes over the epoch; return mean losses [R, 1 + C]."""
        config, params = self.config, critics.flatten(0, 1).numpy()
        descent = Descent(
            net=self.nets.critic,
            params=params,
            moments=moments.arrays,
            inputs=epoch.observation.numpy(),
            batch_size=config.batch_size,
            rate=config.learning_rate,
        )
        loss, own = Squared(epoch.value_targets.numpy()), kernel.of(params)
        total = np.zeros(len(params))
        for _ in range(config.critic_iterations):
            total += own.descend(descent, loss, orders(steps, generators), steps)
        count = np.maximum(-(-steps // config.batch_size) * config.critic_iterations, 1)
        return tensor(total.reshape(len(steps), -1) / count[:, None]).float()

    def _followed(self, state: OnPolicyState, epoch: EpochData, ahead: bool) -> OnPolicyState:
        """Return the state after multipliers have followed the epoch's costs: the ones that do so
        `ahead` of the policy, or the others."""
        assert epoch.discounted_cost is not None
        what = (self.rule.multipliers, self.config, state.multipliers)
        costs = (array(epoch.cost), array(epoch.discounted_cost))
        return state._replace(multipliers=lagrange.follow(*what, *costs, ahead=ahead))

    def _epoch(self, rollout: Rollout, packing: Packing) -> EpochData:
        """Return the packed steps of an epoch, with advantages and value targets."""
        columns = (rollout.observation, rollout.next_observation)
        observation, following = (self._seen(packing.pack(column)) for column in columns)
        value, next_value = self._values(observation), self._values(following)
        terminal = rollout.terminal(self.config.time_limit)
        gains = []
        for k, signal in enumerate((rollout.reward, *np.moveaxis(rollout.cost, -1, 0))):
            unpacked = packing.unpack(value[:, k]), packing.unpack(next_value[:, k])
            discounts = self.config.discount, self.config.gae_lambda
            gain = advantages(signal, *unpacked, terminal, rollout.during, *discounts)
            gains.append(packing.pack(gain))
        gain = np.stack(gains, axis=1)
        targets = tensor(gain) + tensor(value)
        reward, costs = gain[:, 0], gain[:, 1:]
        for run, n in enumerate(packing.steps):
            if n:
                reward[run, :n] -= reward[run, :n].mean()
                reward[run, :n] /= reward[run, :n].std() + 1e-8
                for cost in costs[run, :, :n]:
                    cost -= cost.mean()
                    if getattr(self.config, "standardize_cost_advantages", False):
                        cost /= cost.std() + 1e-8
        shape = (len(self.seeds), self.episodes)
        sums = (rollout.cost_returns, rollout.discounted_costs(self.config.discount))
        cost, discounted_cost = (tensor(s.reshape(*shape, -1).mean(axis=1)) for s in sums)
        return EpochData(
            observation=observation,
            action=tensor(packing.pack(rollout.action)),
            weight=tensor(packing.weight),
            reward_advantage=tensor(np.ascontiguousarray(reward)),
            cost_advantage=tensor(np.ascontiguousarray(costs)),
            value_targets=targets,
            length=tensor(rollout.length.reshape(shape).mean(axis=1)).float(),
            cost=cost,
            discounted_cost=discounted_cost,
        )

    def _seen(self, observation: NDArray[np.float32]) -> torch.Tensor:
        """Return packed observations of a `learned` rollout as the networks see them."""
        return tensor(self._normalizer.inputs(observation) if self._normalizer else observation)

    def _values(self, observation: torch.Tensor) -> NDArray[np.float32]:
        """Return the critics' values, [R, 1 + C, B]."""
        return array(self.nets.critic.forward_each(self._state.critics, observation))

    def _std(self) -> torch.Tensor:
        """Return the standard deviation of each run's policy, mean over action components: [R]."""
        start, actions = self.nets.actor.net.size, self.action_size
        return self._state.actor[:, start : start + actions].exp().mean(dim=-1)

    def finite(self) -> NDArray[np.bool_]:
        """Return a mask [R] of the runs whose numbers are all finite."""
        return tree.finite(self._state)

    def state_dict(self) -> dict[str, NDArray]:
        """Return the whole training state as named arrays."""
        parts = (self._normalizer, self._tail)
        dicts = [part.state_dict() for part in parts if part is not None]
        return functools.reduce(operator.or_, dicts, tree.flatten(self._state))

    def load_state_dict(self, state: dict[str, NDArray]) -> None:
        """Load a state, bit for bit. Raises KeyError or ValueError if it does not fit."""
        self._state = tree.unflatten(self._state, state)
        for part in (self._normalizer, self._tail):
            if part is not None:
                part.load_state_dict(state)
