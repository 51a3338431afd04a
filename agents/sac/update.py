"""The update that the SAC family shares: SAC with two reward critics and two cost critics.

An algorithm adds a `CostRule`. Losses are summed over runs and averaged over the batch, so
the gradient of one run does not see the others. Source: Haarnoja et al. 2018 ("Soft actor-critic
algorithms and applications") with the cost terms of the algorithm's paper.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor

from agents.errors import check, check_choice, check_integers
from agents.lockstep import lagrange
from agents.lockstep.adam import Moments, adam, no_moments
from agents.lockstep.backend import tensor
from agents.lockstep.compiling import compiled
from agents.lockstep.lagrange import MultiplierForm, MultiplierState, PIDState
from agents.lockstep.nets import LANES, MLP, check_lanes
from agents.lockstep.noise import Purpose, stream
from agents.lockstep.replay import Batch
from agents.sac import squashed_gaussian


@dataclass(frozen=True)
class SACConfig:
    """Hyper-parameters of the SAC family.

    The defaults are the paper's (table HP_Circle2D) but for the time limit; presets set it for
    Circle2D.
    """

    discount: float = 0.99
    """Discount factor γ of rewards and costs, in [0, 1]. Paper: 0.99."""
    learning_rate: float = 3e-4
    """Adam's step size for actor, critics and temperature. Paper: 3e-4."""
    batch_size: int = 256
    """Transitions a gradient step; a multiple of 32, at most the replay's size. Paper: 256."""
    gradient_steps: int = 5
    """Gradient steps an epoch, which is one episode. Paper: 5."""
    random_steps: int = 5_000
    """Environment steps at the start that take uniformly random actions. Paper: 5000 on Circle2D,
    50000 on Safety-Gymnasium."""
    random_exponent: float = 0.0
    """Exponent β of the random actions' power spectrum 1/f^β: 0 white, 1 pink, 2 brown noise, which
    keeps a direction for many steps. Each action is uniform by itself. Paper: white, as usual."""
    replay_size: int = 50_000
    """Transitions the replay of a run holds. Paper: 50000 on Circle2D, 500000 on
    Safety-Gymnasium."""
    hidden: tuple[int, ...] = (64, 64)
    """Sizes of the hidden layers of actor and critics (tanh); multiples of 32. Paper: 64, 64."""
    input_scale: float = 1.0
    """Factor on observations before the networks. Small tanh networks are smooth: observations in
    [-1, 1] whose details matter want a larger one. Not in the paper; 1 leaves them as they are."""
    target_rate: float = 0.005
    """Share τ by which the target critics follow. Not printed in the paper; 0.005 as in Haarnoja et
    al."""
    target_steps: int = 1
    """Steps n whose rewards and costs a target sums before it bootstraps, without correction for
    the policy that took them. Paper: 1, as usual."""
    time_limit: Literal["bootstrap", "terminal"] = "bootstrap"
    """Whether to bootstrap at the time limit. Inferred for the paper's Circle2D, not printed:
    terminal."""

    def __post_init__(self) -> None:
        """Raises UserError naming the value that is not allowed."""
        check_integers(self, "target_steps", low=1, high=1000)
        check_integers(self, "gradient_steps", low=1, high=100_000)
        check_integers(self, "replay_size", low=1)
        check_integers(self, "batch_size", low=1, high=self.replay_size)
        check_integers(self, "random_steps", low=0)
        check(self, "discount", "target_rate", low=0, high=1)
        check(self, "learning_rate", above=0, high=1)
        check(self, "random_exponent", low=0, high=4)
        check(self, "input_scale", low=1e-6, high=1e6)
        check_lanes(self)
        check_choice(self, "time_limit", "bootstrap", "terminal")


@dataclass(frozen=True)
class ConstrainedSACConfig(SACConfig):
    """Hyper-parameters of the SAC family's algorithms that limit a cost.

    The default is that of the paper's other tasks; presets set it for Circle2D.
    """

    limited_cost = "discounted cost return Q_c"  # in words, for tables
    cost_limit: float = 25.0
    """Limit d of the discounted cost return Q_c that the cost critics estimate, with the discount γ
    of the rewards; not of an episode's cost. Paper: 5 on Circle2D, 25 on Safety-Gymnasium."""
    streak_weight: float = 0.0
    """Weight β ≥ 0 of streaks in the cost that is learned and limited: the k-th consecutive cost
    step costs `1 + β (k - 1)` times. Records keep the plain cost. Not in the paper; 0: none."""

    def __post_init__(self) -> None:
        """Raises UserError naming the value that is not allowed."""
        super().__post_init__()
        check(self, "cost_limit", low=0, high=1e9)
        check(self, "streak_weight", low=0, high=1e6)


class CostRule(NamedTuple):
    """How an algorithm of the family treats costs. Every function takes its config first.

    `cost_values` are the outputs of the two cost critics, [R, 2, B].
    """

    risk: Callable[[Any, Tensor], Tensor]
    """(config, cost_values) -> [R, B]: cost estimate that the actor penalises."""
    critic_loss: Callable[[Any, Tensor, Tensor, Batch], Tensor]
    """(config, cost_values, the target critics' at the next action, batch) -> [R]."""
    penalty: Callable[[Any, Tensor, Tensor], Tensor]
    """(config, risk [R, B], multiplier [R, 1]) -> [R, B]: added to the actor's loss. The multiplier
    is 0 where the rule has none."""
    multiplier_form: MultiplierForm | None = None
    """How the multiplier is parametrised; it follows `E[risk] - d`. None for an algorithm without
    one."""


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
    """[R, 4, critic size]: two for the reward, two for the cost"""
    targets: Tensor
    """[R, 4, critic size]"""
    log_temperature: Tensor
    """[R, LANES]"""
    multiplier: MultiplierState | PIDState | None
    actor_moments: Moments
    critic_moments: Moments
    temperature_moments: Moments


class UpdateNoise(NamedTuple):
    """The random numbers of one update: standard normal, [R, B, action size]."""

    next_action: Tensor
    new_action: Tensor


def make_nets(config: SACConfig, observation_size: int, action_size: int) -> Nets:
    """Nets for flat observations and actions."""
    return Nets(
        actor=MLP((observation_size, *config.hidden, 2 * action_size)),
        critic=MLP((observation_size + action_size, *config.hidden, 1)),
    )


def initial_state(nets: Nets, config: Any, rule: CostRule, seeds: Sequence[int]) -> SACState:
    """The state of runs before their first update; each run's comes from its seed alone."""
    streams = [stream(seed, Purpose.PARAMETERS) for seed in seeds]
    actor = tensor(np.stack([nets.actor.initial(rng) for rng in streams]))
    critics = [[nets.critic.initial(rng) for _ in range(4)] for rng in streams]
    critics = tensor(np.array(critics))
    log_temperature = torch.zeros(len(seeds), LANES)
    return SACState(
        actor=actor,
        critics=critics,
        targets=critics.clone(),
        log_temperature=log_temperature,
        multiplier=lagrange.initial(rule.multiplier_form, config, len(seeds)),
        actor_moments=no_moments(actor),
        critic_moments=no_moments(critics),
        temperature_moments=no_moments(log_temperature),
    )


def values(nets: Nets, critics: Tensor, observation: Tensor, action: Tensor) -> Tensor:
    """Values of the four critics of each run: [R, 4, B]."""
    inputs = torch.cat([observation, action], dim=-1)
    runs, batch, width = inputs.shape
    inputs = inputs[:, None].expand(runs, 4, batch, width).reshape(runs * 4, batch, width)
    return nets.critic.forward(critics.flatten(0, 1), inputs).view(runs, 4, batch)


def critic_loss(
    nets: Nets,
    config: Any,
    rule: CostRule,
    critics: Tensor,
    batch: Batch,
    reward_target: Tensor,
    next_cost_values: Tensor,
) -> tuple[Tensor, dict[str, Tensor]]:
    """Half the mean squared error of each reward critic, and the rule's loss of the cost critics.

    Returns the sum over runs, and both parts [R].
    """
    q = values(nets, critics, batch.observation, batch.action)
    error = q[:, :2] - reward_target[:, None]
    reward_part = 0.5 * (error * error).mean(dim=-1).sum(dim=-1)
    cost_part = rule.critic_loss(config, q[:, 2:], next_cost_values, batch)
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
) -> tuple[Tensor, tuple[Tensor, Tensor, Tensor]]:
    """`E[α log π - min Q + penalty(risk)]` over actions drawn anew.

    Returns the sum over runs, and [R], risk [R, B] and log π [R, B] without gradient.
    """
    outputs = nets.actor.forward(actor, batch.observation)
    action, log_prob = squashed_gaussian.sample(outputs, noise)
    q = values(nets, critics, batch.observation, action)
    risk = rule.risk(config, q[:, 2:])
    temperature = state.log_temperature.exp()[:, :1]
    multiplier = lagrange.value(rule.multiplier_form, state.multiplier, len(actor))
    penalty = rule.penalty(config, risk, multiplier)
    reward = torch.minimum(q[:, 0], q[:, 1])
    loss = (temperature * log_prob - reward + penalty).mean(dim=-1)
    return loss.sum(), (loss.detach(), risk.detach(), log_prob.detach())


def targets_of(
    nets: Nets, config: SACConfig, state: SACState, batch: Batch, noise: Tensor
) -> tuple[Tensor, Tensor]:
    """`r + γ (min Q' - α log π)` at the next action, and the target cost critics' values there.

    -> [R, B] and [R, 2, B].
    """
    outputs = nets.actor.forward(state.actor, batch.next_observation)
    action, log_prob = squashed_gaussian.sample(outputs, noise)
    q = values(nets, state.targets, batch.next_observation, action)
    soft_value = torch.minimum(q[:, 0], q[:, 1]) - state.log_temperature.exp()[:, :1] * log_prob
    return batch.reward + config.discount * (1.0 - batch.terminal) * soft_value, q[:, 2:]


@compiled
def update(
    nets: Nets, config: Any, rule: CostRule, state: SACState, batch: Batch, noise: UpdateNoise
) -> tuple[SACState, dict[str, Tensor]]:
    """One gradient step of critics, actor, temperature and multiplier, in this order.

    Temperature and multiplier see the actions that the actor's step was computed from. Returns the
    new state and, for the records, means over the batch, [R] each.
    """
    rate = config.learning_rate
    reward_target, next_cost_values = targets_of(nets, config, state, batch, noise.next_action)

    def of_critics(critics: Tensor) -> tuple[Tensor, dict[str, Tensor]]:
        return critic_loss(nets, config, rule, critics, batch, reward_target, next_cost_values)

    gradient, metrics = torch.func.grad(of_critics, has_aux=True)(state.critics)
    critics, critic_moments = adam(state.critics, gradient, state.critic_moments, rate)

    def of_actor(actor: Tensor) -> tuple[Tensor, tuple[Tensor, Tensor, Tensor]]:
        return actor_loss(nets, config, rule, actor, critics, state, batch, noise.new_action)

    gradient, (loss, risk, log_prob) = torch.func.grad(of_actor, has_aux=True)(state.actor)
    actor, actor_moments = adam(state.actor, gradient, state.actor_moments, rate)
    metrics |= {
        "actor_loss": loss,
        "temperature": state.log_temperature.exp()[:, 0],
        "multiplier": lagrange.value(rule.multiplier_form, state.multiplier, len(actor))[:, 0],
        "risk": risk.mean(dim=-1),
        "entropy": -log_prob.mean(dim=-1),
    }
    state = state._replace(
        actor=actor,
        critics=critics,
        targets=state.targets.lerp(critics, config.target_rate),
        actor_moments=actor_moments,
        critic_moments=critic_moments,
    )
    state = temperature_step(config, state, log_prob, batch.action.shape[-1])
    if isinstance(state.multiplier, MultiplierState):  # a PID controller's follows once an epoch
        cost, form = risk.mean(dim=-1, keepdim=True), rule.multiplier_form
        state = state._replace(multiplier=lagrange.follow(form, config, state.multiplier, cost))
    return state, metrics


def temperature_step(
    config: SACConfig, state: SACState, log_prob: Tensor, action_size: int
) -> SACState:
    """Descend `-α E[log π + target entropy]`, target entropy -A, along log α; log_prob: [R, B]."""
    excess = log_prob.mean(dim=-1, keepdim=True) - action_size
    gradient = -state.log_temperature.exp() * excess
    log_temperature, moments = adam(
        state.log_temperature, gradient, state.temperature_moments, config.learning_rate
    )
    return state._replace(log_temperature=log_temperature, temperature_moments=moments)
