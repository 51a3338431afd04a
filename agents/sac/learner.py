"""The epoch of the off-policy family: one episode, then gradient steps."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import nn

from agents.lockstep import lagrange, tree
from agents.lockstep.kernel import Float
from agents.lockstep.lagrange import PIDState
from agents.lockstep.nets import Activation, forward_numpy
from agents.lockstep.noise import (
    Purpose,
    correlated_uniform,
    normal,
    steps_of_noise,
    streams,
    uniform,
)
from agents.lockstep.normalizer import Inputs
from agents.lockstep.rollout import Act, Policy, Rollout, critic_inputs, learned
from agents.lockstep.streaks import SEEN, StreakTail, longest_at_records, with_last_cost
from agents.sac import update as sac
from agents.sac.replay import STARTS, Batch, Novelty, Recent, Replay, ReturnScale
from agents.sac.update import SACConfig


def _act(
    layers: Sequence[NDArray[np.float32]],
    activation: Activation,
    inputs: Inputs,
    observation: NDArray[np.float32],
    noise: NDArray[np.float32] | None,
) -> NDArray[np.float32]:
    return sac.act(forward_numpy(layers, inputs(observation), activation), noise)


class OffPolicy:
    """The runs of one algorithm of the SAC family: their networks and replay buffers."""

    takes = (SACConfig, sac.CostRule)
    off_policy = True

    def __init__(
        self,
        config: Any,
        rule: sac.CostRule,
        seeds: Sequence[int],
        observation_size: int,
        action_size: int,
    ) -> None:
        rule = lagrange.with_streaks(rule, config)
        sac.check_rule(config, rule)
        self.config, self.rule, self.seeds = config, rule, tuple(seeds)
        self.episodes = 1
        cost_critics = ("cost_critic_loss",) * (rule.costs > 0)
        usual = ("critic_loss", *cost_critics, "actor_loss", "temperature")
        self._multipliers = lagrange.names(rule.multipliers)
        self._risks = lagrange.numbered("risk", rule.costs)
        self.metrics = (*usual, *self._multipliers, *self._risks, "entropy")
        self.action_size, self.costs = action_size, rule.costs
        self.nets = sac.make_nets(config, observation_size, action_size, rule.costs)
        self._state = sac.initial_state(self.nets, config, rule, seeds)
        inputs = critic_inputs(config, observation_size, rule.costs)
        self._kept = config.random_steps if config.random_share else 0
        sizes = (inputs, action_size, rule.costs)
        self._replay = Replay(len(seeds), config.replay_size, *sizes, self._kept)
        limited = getattr(config, "streak_limit", None) is not None
        alpha = getattr(config, "streak_alpha", 1.0)
        self._tail = StreakTail(len(seeds), alpha) if limited else None
        self._novelty = (
            Novelty(config.novelty_length, seeds, observation_size - SEEN * limited)
            if config.novelty_bonus
            else None
        )
        self._normalizer = config.normalizer(len(seeds), observation_size)
        self._multiplier_of = getattr(config, "multiplier_of", "replay")
        follows = self._multiplier_of != "replay"
        self._recent = Recent(len(seeds), inputs, rule.costs) if follows else None
        running = config.reward_scale == "running"
        self._scale = ReturnScale(len(seeds), config.discount) if running else None

    def policy(self) -> Policy:
        """Return the current policy of every run."""
        net = self.nets.actor
        layers = net.layers(self._state.actor)
        return functools.partial(_act, layers, net.activation, self._inputs)

    def module(self, run: int) -> nn.Module:
        """Return a run's deterministic policy in PyTorch: observations -> actions in [-1, 1]."""
        layers = [layer[run] for layer in self.nets.actor.layers(self._state.actor)]
        layers[-2:] = [layer[..., : self.action_size] for layer in layers[-2:]]  # the mean's
        return self._inputs.module(run, layers, self.nets.actor.activation).append(nn.Tanh())

    @property
    def _inputs(self) -> Inputs:
        return self.config.inputs(self._normalizer)

    def explorer(self, epoch: int, steps: NDArray[np.int64]) -> Act:
        """Return the function that acts in an epoch: random until `random_steps`, then the policy.

        steps: [R], environment steps that each run has taken before.
        """
        policy, shape = self.policy(), (self.action_size,)
        noise = steps_of_noise(normal, self.seeds, Purpose.EXPLORATION, epoch, shape)
        random_actions = steps_of_noise(
            self._random, self.seeds, Purpose.RANDOM_ACTIONS, epoch, shape
        )
        step = steps.copy()

        def act_by_policy(observation: NDArray[np.float32]) -> NDArray[np.float32]:
            return policy(observation[:, None], next(noise)[:, None])[:, 0]

        def act(observation: NDArray[np.float32]) -> NDArray[np.float32]:
            at_random = step < self.config.random_steps
            step[:] += 1
            return np.where(at_random[:, None], next(random_actions), act_by_policy(observation))

        return act if (steps < self.config.random_steps).any() else act_by_policy

    def _random(self, rng: np.random.Generator, size: tuple[int, ...]) -> NDArray[np.float32]:
        """Draw uniformly random actions; with a `random_exponent` they are correlated over time."""
        exponent = self.config.random_exponent
        return correlated_uniform(rng, size, exponent) if exponent else uniform(rng, size)

    def learn(self, rollout: Rollout, epoch: int, active: NDArray[np.bool_]) -> NDArray:
        """Store an epoch's episodes and take its gradient steps; active: [R], runs that take part.

        Returns the means of `metrics` over the gradient steps, [R, metrics]; NaN for runs that take
        none: they have no part, or their replay buffer holds less than a batch.
        """
        length = np.where(active, rollout.length, 0)
        of_rewards = of_costs = self.config.time_limit
        if of_rewards == "terminal_cost":
            of_rewards, of_costs = "bootstrap", "terminal"
        ends = rollout.terminal(of_rewards), rollout.terminal(of_costs)
        rollout = learned(rollout, self.config, self.costs)._replace(length=length)
        held = rollout
        if self._tail:
            self._tail.count(rollout)
            held = with_last_cost(rollout, longest_at_records(rollout))
        self._replay.add(held, *ends)
        if self._recent:
            self._recent.add(rollout)
        if self._novelty:
            self._novelty.add(rollout.next_observation, rollout.length)
        if self._scale:
            self._scale.add(rollout.reward, rollout.length)
        metrics = self._update(epoch, active & (self._replay.size >= self.config.batch_size))
        if self._normalizer:
            self._normalizer.count(rollout.observation, rollout.length)
        return metrics

    def _update(self, epoch: int, learning: NDArray[np.bool_]) -> NDArray:
        """Take an epoch's gradient steps; learning: [R], runs that do. Returns as `learn`."""
        if not learning.any():
            return np.full((len(self.seeds), len(self.metrics)), np.nan)
        before, self._state, total = self._state, tree.copy(self._state), 0.0
        longest = self._tail.recent if self._tail and self.rule.multipliers else None
        for index, noise in self._draws(epoch):
            batch = self._as_learned(self._replay.gather(index))
            what = (self.nets, self.config, self.rule, self._state)
            self._state, metrics = sac.update(*what, batch, noise, self._followed(noise), longest)
            total = total + self._columns(metrics)
        means = total / self.config.gradient_steps
        self._control_multipliers(means[:, -1 - self.costs : -1])
        self._state = tree.where(learning, self._state, before)
        return np.where(learning[:, None], means, np.nan)

    def _columns(self, records: dict[str, Float]) -> Float:
        """Return the records of an update in the order of `metrics`, [R, metrics]."""
        named = records | dict(zip(self._multipliers, records["multipliers"].T, strict=True))
        named |= dict(zip(self._risks, records["risks"].T, strict=True))
        return np.stack([named[name] for name in self.metrics], axis=-1)

    def _followed(self, noise: sac.UpdateNoise) -> Float | None:
        """Return the costs that multipliers follow instead of a batch's risk, [R, C], or None: see
        `multiplier_of`."""
        if self._recent is None:
            return None
        if self._multiplier_of == "episode":
            of = functools.partial(self.rule.of_episodes, self.config)
            return self._recent.costs(of)
        starts, weight = self._recent.starts
        seen = self._normalizer.inputs(starts) if self._normalizer else starts
        what = (self.nets, self.config, self.rule, self._state)
        return sac.risk_at(*what, seen, noise.start_action, weight)

    def _as_learned(self, batch: Batch) -> Batch:
        """Return the batch as networks learn from it, by the current statistics of the runs:
        rewards are scaled and include the `novelty_bonus`, record costs count beyond the quantile,
        and observations are normalised."""
        if self._tail:
            beyond = self._tail.beyond(batch.cost[:, -1])
            batch = batch._replace(cost=np.concatenate([batch.cost[:, :-1], beyond[:, None]], 1))
        if self._scale:
            batch = batch._replace(reward=self._scale.of(batch.reward))
        if self._novelty:
            novelty = self._novelty.of(batch.next_observation)
            batch = batch._replace(reward=batch.reward + self.config.novelty_bonus * novelty)
        if self._normalizer:
            seen = self._normalizer.inputs
            names = ("observation", "next_observation")
            batch = batch._replace(**{k: seen(getattr(batch, k)) for k in names})
        return batch

    def _control_multipliers(self, risks: Float) -> None:
        """Take one step of PID multipliers; risks: [R, C], means over the epoch's gradient steps.

        The controller steps once per epoch, as on-policy: the gains are meant for that, and the
        derivative term of single minibatches would be mostly noise.
        """
        if any(isinstance(state, PIDState) for state in self._state.multipliers):
            multipliers, states = self.rule.multipliers, self._state.multipliers
            after = lagrange.follow(multipliers, self.config, states, risks)
            self._state = self._state._replace(multipliers=after)

    def finite(self) -> NDArray[np.bool_]:
        """Return a mask [R] of the runs whose numbers are all finite."""
        return tree.finite(self._state)

    def _draws(self, epoch: int) -> list[tuple[NDArray[np.int64], sac.UpdateNoise]]:
        """Draw the random numbers of an epoch's gradient steps: slots [R, B] and action noise."""
        steps, batch = self.config.gradient_steps, self.config.batch_size
        share, action_noise, start_noise = [], [], []
        for rng in streams(self.seeds, Purpose.UPDATE, epoch):
            share.append(rng.random((steps, batch)))
            action_noise.append(normal(rng, (steps, 2, batch, self.action_size)))
            if self._multiplier_of == "start":
                start_noise.append(normal(rng, (steps, STARTS, self.action_size)))
        index = self._slots(np.stack(share, axis=1))
        # The action axis comes first in memory, as in `sampled`.
        noise = np.ascontiguousarray(np.array(action_noise).transpose(1, 2, 4, 0, 3))
        following, new = noise.transpose(1, 0, 3, 4, 2)
        starts = np.stack(start_noise, axis=1) if start_noise else [None] * steps
        noises = [sac.UpdateNoise(following[k], new[k], starts[k]) for k in range(steps)]
        return list(zip(index, noises, strict=True))

    def _slots(self, share: NDArray[np.float64]) -> NDArray[np.int64]:
        """Map numbers [steps, R, B] in [0, 1) to slots of the replay buffer: the first
        `random_share` of a batch to kept transitions, the others to the rest, if there is any."""
        held = np.maximum(self._replay.size, 1)[:, None]
        kept = np.minimum(held, self._kept)
        of_kept = np.arange(share.shape[-1]) < round(self.config.random_share * share.shape[-1])
        low = np.where(of_kept | (held == kept), 0, kept)
        high = np.where(of_kept, kept, held)
        return (low + share * (high - low)).astype(np.int64)

    @property
    def _parts(self) -> dict[str, Replay | Recent | Novelty | ReturnScale | StreakTail]:
        parts = {"replay": self._replay, "recent": self._recent, "streaks": self._tail}
        parts |= {"novelty": self._novelty, "scale": self._scale}
        return {name: part for name, part in parts.items() if part is not None}

    def state_dict(self) -> dict[str, NDArray]:
        """Return the whole training state as named arrays."""
        parts = {
            f"{name}.{key}": value
            for name, part in self._parts.items()
            for key, value in part.state_dict().items()
        }
        normalizer = self._normalizer.state_dict() if self._normalizer else {}
        return {**tree.flatten(self._state), **parts, **normalizer}

    def load_state_dict(self, state: dict[str, NDArray]) -> None:
        """Load a state, bit for bit. Raises KeyError or ValueError if it does not fit."""
        self._state = tree.unflatten(self._state, state)
        if self._normalizer:
            self._normalizer.load_state_dict(state)
        for name, part in self._parts.items():
            prefix = f"{name}."
            arrays = {k.removeprefix(prefix): v for k, v in state.items() if k.startswith(prefix)}
            part.load_state_dict(arrays)
