"""The update that the SAC family shares: SAC with two reward critics and two cost critics.

An algorithm adds a `CostRule`. Losses are summed over runs and averaged over the batch, so
the gradient of one run does not see the others. Source: Haarnoja et al. 2018 ("Soft actor-critic
algorithms and applications") with the cost terms of the algorithm's paper.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from agents.lockstep import lagrange
from agents.lockstep.adam import Moments, adam, no_moments
from agents.lockstep.backend import tensor
from agents.lockstep.compiling import compiled
from agents.lockstep.lagrange import Multiplier, MultiplierState, State
from agents.lockstep.learned import critic_inputs
from agents.lockstep.nets import LANES, MLP
from agents.lockstep.noise import Purpose, stream
from agents.lockstep.replay import Batch
from agents.sac import squashed_gaussian
from agents.sac.config import SACConfig


class CostRule(NamedTuple):
    """How an algorithm of the family treats costs. Every function takes its config first.

    `cost_values` are the outputs of one cost's critics, two by default, [R, 2, B].
    """

    risk: Callable[[Any, Tensor], Tensor]
    """(config, cost_values) -> [R, B]: estimate of a cost that the actor penalises."""
    critic_loss: Callable[[Any, Tensor, Tensor, Batch], Tensor]
    """(config, cost_values, the target critics' at the next action, batch with that cost [R, B])
    -> [R]."""
    penalty: Callable[[Any, Tensor, Tensor], Tensor]
    """(config, risks [R, C, B], multipliers [R, M]) -> [R, C, B]: added to the actor's loss, each
    cost's."""
    multipliers: tuple[Multiplier, ...] = ()
    """Each follows `E[risk] - d` of its cost."""
    costs: int = 1
    """How many costs are learned, by a pair of critics each, or by `cost_critics` of the config."""
    augmented: Callable[[Any, Tensor, Tensor], Tensor] | None = None
    """(config, multipliers [R, M], mean risks [R, C] at the batch's own actions) -> [R, M]: the
    multipliers that the penalty sees. Where it is given, multipliers follow that risk, too, instead
    of the risk at new actions of the policy."""


class Nets(NamedTuple):
    """The shapes of the networks."""

    actor: MLP
    critic: MLP


class SACState(NamedTuple):
    """Everything an update reads and writes.

    Numbers that are one a run (temperature, multiplier) fill a row of 32 equal ones: see `nets`.
    """

    actor: Tensor
    """[R, actor size]"""
    critics: Tensor
    """[R, 2 + 2·C, critic size]: two for the reward, two (`cost_critics`) for each cost"""
    targets: Tensor
    """[R, 2 + 2·C, critic size]"""
    log_temperature: Tensor
    """[R, LANES]"""
    multipliers: tuple[State, ...]
    actor_moments: Moments
    critic_moments: Moments
    temperature_moments: Moments


class UpdateNoise(NamedTuple):
    """The random numbers of one update: standard normal, [R, B, action size]."""

    next_action: Tensor
    new_action: Tensor


def make_nets(config: SACConfig, observation_size: int, action_size: int, costs: int) -> Nets:
    """Nets for flat observations and actions."""
    seen = critic_inputs(config, observation_size, costs) + action_size
    return Nets(
        actor=MLP((observation_size, *config.hidden, 2 * action_size), config.activation),
        critic=MLP((seen, *config.hidden, 1), config.activation),
    )


def initial_state(nets: Nets, config: Any, rule: CostRule, seeds: Sequence[int]) -> SACState:
    """The state of runs before their first update; each run's comes from its seed alone."""
    streams = [stream(seed, Purpose.PARAMETERS) for seed in seeds]
    actor = tensor(np.stack([nets.actor.initial(rng) for rng in streams]))
    count = 2 + config.cost_critics * rule.costs
    critics = [[nets.critic.initial(rng) for _ in range(count)] for rng in streams]
    critics = tensor(np.array(critics))
    log_temperature = torch.zeros(len(seeds), LANES)
    return SACState(
        actor=actor,
        critics=critics,
        targets=critics.clone(),
        log_temperature=log_temperature,
        multipliers=lagrange.initial(rule.multipliers, config, len(seeds)),
        actor_moments=no_moments(actor),
        critic_moments=no_moments(critics),
        temperature_moments=no_moments(log_temperature),
    )


def values(nets: Nets, critics: Tensor, observation: Tensor, action: Tensor) -> Tensor:
    """Values of all critics of each run: [R, 2 + 2·C, B]."""
    inputs = torch.cat([observation, action], dim=-1)
    (runs, batch, width), count = inputs.shape, critics.shape[1]
    inputs = inputs[:, None].expand(runs, count, batch, width).reshape(runs * count, batch, width)
    return nets.critic.forward(critics.flatten(0, 1), inputs).view(runs, count, batch)


def cost_critics(values: Tensor, rule: CostRule) -> list[Tensor]:
    """The outputs [R, 2, B] of each cost's critics among those of all critics."""
    return list(values[:, 2:].chunk(rule.costs, dim=1))


def risks(config: Any, rule: CostRule, values: Tensor) -> Tensor:
    """The risk of each cost, [R, C, B], from the outputs of all critics."""
    return torch.stack([rule.risk(config, own) for own in cost_critics(values, rule)], dim=1)


def critic_loss(
    nets: Nets,
    config: Any,
    rule: CostRule,
    critics: Tensor,
    batch: Batch,
    reward_target: Tensor,
    next_values: Tensor,
) -> tuple[Tensor, dict[str, Tensor]]:
    """Half the mean squared error of each reward critic, and the rule's loss of the cost critics.

    next_values: of all target critics at the next action, [R, 2 + 2·C, B].

    Returns the sum over runs, and both parts [R].
    """
    q = values(nets, critics, batch.observation, batch.action)
    error = q[:, :2] - reward_target[:, None]
    reward_part = 0.5 * (error * error).mean(dim=-1).sum(dim=-1)
    both = cost_critics(q, rule), cost_critics(next_values, rule)
    pairs = enumerate(zip(*both, strict=True))
    losses = [
        rule.critic_loss(config, *pair, batch._replace(cost=batch.cost[:, k])) for k, pair in pairs
    ]
    cost_part = sum(losses[1:], start=losses[0])
    parts = {"critic_loss": reward_part.detach(), "cost_critic_loss": cost_part.detach()}
    return (reward_part + cost_part).sum(), parts


def actor_loss(
    nets: Nets,
    config: Any,
    rule: CostRule,
    actor: Tensor,
    critics: Tensor,
    state: SACState,
    batch: Batch,
    noise: Tensor,
    multipliers: Tensor,
) -> tuple[Tensor, tuple[Tensor, Tensor, Tensor]]:
    """`E[α log π - min Q + penalty(risk)]` over actions drawn anew; multipliers: [R, M].

    Returns the sum over runs, and [R], risks [R, C, B] and log π [R, B] without gradient.
    """
    outputs = nets.actor.forward(actor, nets.actor.inputs_of(batch.observation))
    action, log_prob = squashed_gaussian.sample(outputs, noise)
    q = values(nets, critics, batch.observation, action)
    risk = risks(config, rule, q)
    temperature = state.log_temperature.exp()[:, :1]
    penalty = rule.penalty(config, risk, multipliers).sum(dim=1)
    reward = torch.minimum(q[:, 0], q[:, 1])
    loss = (temperature * log_prob - reward + penalty).mean(dim=-1)
    return loss.sum(), (loss.detach(), risk.detach(), log_prob.detach())


def targets_of(
    nets: Nets, config: SACConfig, state: SACState, batch: Batch, noise: Tensor
) -> tuple[Tensor, Tensor]:
    """`r + γ (min Q' - α log π)` at the next action, and all target critics' values there.

    -> [R, B] and [R, 2 + 2·C, B].
    """
    outputs = nets.actor.forward(state.actor, nets.actor.inputs_of(batch.next_observation))
    action, log_prob = squashed_gaussian.sample(outputs, noise)
    q = values(nets, state.targets, batch.next_observation, action)
    soft_value = torch.minimum(q[:, 0], q[:, 1]) - state.log_temperature.exp()[:, :1] * log_prob
    return batch.reward + config.discount * (1.0 - batch.terminal) * soft_value, q


@compiled
def update(
    nets: Nets, config: Any, rule: CostRule, state: SACState, batch: Batch, noise: UpdateNoise
) -> tuple[SACState, dict[str, Tensor]]:
    """One gradient step of critics, actor, temperature and multiplier, in this order.

    Temperature and multiplier see the actions that the actor's step was computed from. Returns the
    new state and, for the records, means over the batch: [R], multipliers [R, M], risks [R, C].
    """
    rate = config.learning_rate
    reward_target, next_values = targets_of(nets, config, state, batch, noise.next_action)

    def of_critics(critics: Tensor) -> tuple[Tensor, dict[str, Tensor]]:
        return critic_loss(nets, config, rule, critics, batch, reward_target, next_values)

    gradient, metrics = torch.func.grad(of_critics, has_aux=True)(state.critics)
    critics, critic_moments = adam(state.critics, gradient, state.critic_moments, rate)

    multipliers = in_penalty = lagrange.values(rule.multipliers, state.multipliers, len(critics))
    taken = None
    if rule.augmented:
        taken = values(nets, critics, batch.observation, batch.action)
        taken = risks(config, rule, taken).mean(dim=-1)
        in_penalty = rule.augmented(config, multipliers, taken)

    def of_actor(actor: Tensor) -> tuple[Tensor, tuple[Tensor, Tensor, Tensor]]:
        what = (actor, critics, state, batch, noise.new_action, in_penalty)
        return actor_loss(nets, config, rule, *what)

    gradient, (loss, risk, log_prob) = torch.func.grad(of_actor, has_aux=True)(state.actor)
    actor, actor_moments = adam(state.actor, gradient, state.actor_moments, rate)
    risk = risk.mean(dim=-1) if taken is None else taken
    metrics |= {
        "actor_loss": loss,
        "temperature": state.log_temperature.exp()[:, 0],
        "multipliers": multipliers,
        "risks": risk,
        "entropy": -log_prob.mean(dim=-1),
    }
    log_temperature, temperature_moments = temperature_step(
        config, state, log_prob, batch.action.shape[-1]
    )
    states = state.multipliers
    if all(isinstance(part, MultiplierState) for part in states):  # a PID follows once an epoch
        states = lagrange.follow(rule.multipliers, config, states, risk)
    # One constructor call: of two chained _replace calls torch 2.11 on Python 3.12 returns an empty
    # tuple where it compiles.
    after = SACState(
        actor=actor,
        critics=critics,
        targets=state.targets.lerp(critics, config.target_rate),
        log_temperature=log_temperature,
        multipliers=states,
        actor_moments=actor_moments,
        critic_moments=critic_moments,
        temperature_moments=temperature_moments,
    )
    return after, metrics


def temperature_step(
    config: SACConfig, state: SACState, log_prob: Tensor, action_size: int
) -> tuple[Tensor, Moments]:
    """Descend `-α E[log π + target entropy]`, target entropy -A, along log α; log_prob: [R, B].

    Returns log α and its moments.
    """
    excess = log_prob.mean(dim=-1, keepdim=True) - action_size
    gradient = -state.log_temperature.exp() * excess
    return adam(state.log_temperature, gradient, state.temperature_moments, config.temperature_lr)
