"""The update of the SAC family: SAC with two reward critics, and two critics for each cost.

An algorithm adds a `CostRule`. Losses are summed over runs and averaged over the batch, so the
gradient of one run does not depend on the others. Source: Haarnoja et al. 2018 ("Soft actor-critic
algorithms and applications") with the cost terms of the algorithm's paper.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from agents.checks import In
from agents.errors import UserError
from agents.lockstep import kernel, lagrange
from agents.lockstep.backend import array, tensor
from agents.lockstep.kernel import Float
from agents.lockstep.lagrange import Multiplier, MultiplierConfig, MultiplierState, State
from agents.lockstep.nets import (
    LANES,
    MAY_DIVERGE,
    MLP,
    Activation,
    Moments,
    no_moments,
)
from agents.lockstep.noise import Purpose, stream
from agents.lockstep.normalizer import InputConfig
from agents.lockstep.pulled import Pull, has_closed_form, pulled
from agents.lockstep.rollout import critic_inputs
from agents.sac.replay import Batch

TimeLimit = Literal["bootstrap", "terminal", "terminal_cost"]


@dataclass(frozen=True)
class SACConfig(InputConfig):
    """Hyper-parameters of the SAC family.

    The defaults are the paper's (table HP_Circle2D), except for `time_limit`, which presets set for
    Circle2D.
    """

    cost_critics = 2  # for each cost; an algorithm with an ensemble makes it a hyper-parameter
    cost_estimate = "larger"  # see `SACLagConfig`, which makes it a hyper-parameter

    discount: Annotated[float, In(0, 1)] = 0.99
    """Discount factor γ of rewards and costs, in [0, 1]. Paper: 0.99."""
    learning_rate: Annotated[float, In(above=0, high=1)] = 3e-4
    """Adam's step size for actor and critics. Paper: 3e-4."""
    policy_lr: Annotated[float, In(above=0, high=1)] | None = None
    """Adam's step size for the actor, if it differs from `learning_rate`. Not in the paper."""
    temperature_lr: Annotated[float, In(0, 1)] = 3e-4
    """Adam's step size for the temperature, which falls as the policy becomes less random; with 0
    it stays. Paper: 3e-4, as for the networks."""
    initial_temperature: Annotated[float, In(above=0, high=1e6)] = 1.0
    """Temperature at first. Not specified in the paper; 1."""
    batch_size: Annotated[int, In(1)] = 256
    """Transitions per gradient step, at most `replay_size`. Paper: 256."""
    gradient_steps: Annotated[int, In(1, 100_000)] = 5
    """Gradient steps per epoch, which is one episode. Paper: 5."""
    random_steps: Annotated[int, In(0)] = 5_000
    """Environment steps with uniformly random actions at the start. Paper: 5000 on Circle2D, 50000
    on Safety-Gymnasium."""
    random_exponent: Annotated[float, In(0, 4)] = 0.0
    """Exponent β of the random actions' power spectrum 1/f^β: 0 white, 1 pink, 2 brown noise, which
    keeps a direction for many steps. Each action is uniform by itself. Paper: white, as usual."""
    replay_size: Annotated[int, In(1)] = 50_000
    """Transitions that the replay buffer of a run holds. Paper: 50000 on Circle2D, 500000 on
    Safety-Gymnasium."""
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
    target_rate: Annotated[float, In(0, 1)] = 0.005
    """Share τ by which target networks move towards the critics in a gradient step. Not specified
    in the paper; 0.005 as in Haarnoja et al."""
    time_limit: TimeLimit = "bootstrap"
    """Whether to bootstrap at the time limit: bootstrap (reward and cost), terminal (neither), or
    terminal_cost (reward only). Not specified in the paper; the presets of Circle2D have
    terminal."""
    reward_scale: Literal["none", "running"] = "none"
    """Scale of the learned reward: none, or running, divided by the standard deviation of the
    discounted return so far and clipped to ±10. Records keep the plain reward. Not in the paper;
    none."""
    random_share: Annotated[float, In(0, 1)] = 0.0
    """Share of each batch, in [0, 1], that is drawn from the random actions at the start; above 0
    the replay buffer keeps these to the end. Not in the paper; 0: none."""
    novelty_bonus: Annotated[float, In(0, 1e6)] = 0.0
    """Bonus, in units of reward, that the learned reward gets for states that are new to the run:
    about `novelty_bonus / √(1 + n)` after n visits. Records keep the plain reward. Not in the
    paper; 0: none."""
    novelty_length: Annotated[float, In(1e-6, 1e6)] = 2.0
    """Distance within which states count as the same place for the bonus, in the units of
    observations times `input_scale`, before any normalisation. Not in the paper."""

    def __post_init__(self) -> None:
        """Check the values. Raises UserError naming one that is not allowed."""
        super().__post_init__()
        if self.batch_size > self.replay_size:
            raise UserError(
                f"batch_size must be at most replay_size, {self.replay_size}, got {self.batch_size}"
            )
        if self.random_share and not 0 < self.random_steps < self.replay_size:
            raise UserError(
                "random_share needs random_steps of at least 1 and below replay_size "
                f"{self.replay_size}, got {self.random_steps}"
            )


@dataclass(frozen=True)
class ConstrainedSACConfig(SACConfig):
    """Hyper-parameters of the SAC family's algorithms that limit a cost.

    The default of the limit is that of the paper's other tasks; presets set it for Circle2D.
    """

    cost_limit: Annotated[float, In(0, 1e9)] = 25.0
    """Limit d of the discounted cost return Q_c that the cost critics estimate, with the discount γ
    of the rewards; it is no limit of an episode's cost. Paper: 5 on Circle2D, 25 on
    Safety-Gymnasium."""
    limit_of: Literal["discounted", "episode"] = "discounted"
    """Which cost `cost_limit` limits: Q_c (discounted), or the cost of an episode (episode). With
    episode, the limit of Q_c is `d (1 - γ^T) / ((1 - γ) T)`, T steps being the task's time limit,
    as in Ray's and Yang's code. Not specified in the paper; discounted."""
    streak_weight: Annotated[float, In(0, 1e6)] = 0.0
    """Weight β ≥ 0 of streaks in the cost that is learned and limited: the cost of the k-th
    consecutive cost step is multiplied by `1 + β (k - 1)`, and the critics see k. Records keep the
    plain cost. Not in the paper; 0: none."""

    @property
    def limited_cost(self) -> str:
        """The limited cost in words, for tables."""
        converted = ", converted from an episode's cost," if self.limit_of == "episode" else ""
        return f"discounted cost return Q_c{converted}"


@dataclass(frozen=True)
class MultiplierOfConfig(MultiplierConfig, ConstrainedSACConfig):
    """Hyper-parameters of the SAC family's algorithms that have a multiplier."""

    multiplier_of: Literal["replay", "start", "episode"] = "replay"
    """What the multiplier follows: the risk at the states of the replay buffer, most of which lie
    behind the start of an episode (replay; as in the algorithms' papers), the risk at start states
    of the last 64 episodes (start), or the undiscounted cost of the last 10 episodes, which
    `cost_limit` then limits (episode; as in OmniSafe and FSRL). Not specified in the paper;
    replay."""

    @property
    def limited_cost(self) -> str:
        """The limited cost in words, for tables."""
        of_episode = self.multiplier_of == "episode"
        return "undiscounted cost of an episode" if of_episode else super().limited_cost


LOG_STD = (-20.0, 2.0)
"""Bounds to which the log-std is clamped."""


def act(outputs: NDArray[np.float32], noise: NDArray[np.float32] | None) -> NDArray[np.float32]:
    """Return the actions of `sampled`, [..., A]; without noise the deterministic `tanh(μ)`."""
    half = outputs.shape[-1] // 2
    mean, log_std = outputs[..., :half], outputs[..., half:]
    if noise is None:
        return np.tanh(mean)
    return np.tanh(mean + np.exp(log_std.clip(*LOG_STD)) * noise)


def mean_cost(config: Any, costs: NDArray[np.float64]) -> float:
    """Return the mean of episode costs [E]."""
    return float(costs.mean())


class CostRule(NamedTuple):
    """How an algorithm of the family treats costs. Every function takes its config first, and
    tensors; PyTorch differentiates it unless it has a `closed_form`.

    `cost_values` are the outputs of one cost's critics, two by default, [R, 2, B].
    """

    risk: Callable[[Any, Tensor], Tensor]
    """(config, cost_values) -> [R, B]: the estimate of a cost that the actor is penalised for."""
    critic_loss: Callable[[Any, Tensor, Tensor, Batch], Tensor]
    """(config, cost_values, those of the target networks at the next action, batch with that cost
    [R, B]) -> [R]."""
    penalty: Callable[[Any, Tensor, Tensor], Tensor]
    """(config, risks [R, C, B], multipliers [R, M]) -> [R, C, B]: the term of each cost in the
    actor's loss."""
    multipliers: tuple[Multiplier, ...] = ()
    """Each follows `E[risk] - d` of its cost."""
    costs: int = 1
    """How many costs are learned, each by `cost_critics` critics of the config, by default two."""
    limits: tuple[str, ...] = ("cost_limit",)
    """Names of the hyper-parameters that limit the costs, in the order of the costs; the `limit` of
    a multiplier takes precedence for its cost."""
    augmented: Callable[[Any, Tensor, Tensor], Tensor] | None = None
    """(config, multipliers [R, M], what they follow [R, C]) -> [R, M]: the multipliers that the
    penalty gets. With `augments_replay`, and `multiplier_of` replay, multipliers follow the mean
    risk at the actions of the batch instead of at new actions of the policy."""
    augments_replay: bool = True
    """Whether `augmented` applies also to multipliers that follow the replay buffer."""
    of_episodes: Callable[[Any, NDArray[np.float64]], float] = mean_cost
    """(config, a cost of recent episodes [E]) -> what a multiplier follows with `multiplier_of`
    episode."""


class Nets(NamedTuple):
    """Shapes of the networks."""

    actor: MLP
    critic: MLP


class SACState(NamedTuple):
    """Everything that an update reads and writes.

    A number of which each run has one (temperature, multiplier) is stored as a row of LANES equal
    ones: see `nets`.
    """

    actor: Float
    """[R, actor size]"""
    critics: Float
    """[R, 2 + 2·C, critic size]: two for the reward, `cost_critics`, by default 2, for each cost"""
    targets: Float
    """[R, 2 + 2·C, critic size]"""
    log_temperature: Float
    """[R, LANES]"""
    multipliers: tuple[State, ...]
    actor_moments: Moments
    critic_moments: Moments
    temperature_moments: Moments


class UpdateNoise(NamedTuple):
    """The random numbers of one update: standard normal noise, [R, B, action size]."""

    next_action: Float
    new_action: Float
    start_action: Any = None
    """[R, STARTS, action size], with `multiplier_of` start"""


def make_nets(config: SACConfig, observation_size: int, action_size: int, costs: int) -> Nets:
    """Return the networks for flat observations and actions."""
    seen = critic_inputs(config, observation_size, costs) + action_size
    return Nets(
        actor=MLP((observation_size, *config.hidden, 2 * action_size), config.activation),
        critic=MLP((seen, *config.hidden, 1), config.activation),
    )


def initial_state(nets: Nets, config: Any, rule: CostRule, seeds: Sequence[int]) -> SACState:
    """Return the state before the first update; that of each run depends on its seed alone."""
    streams = [stream(seed, Purpose.PARAMETERS) for seed in seeds]
    actor = np.stack([nets.actor.initial(rng) for rng in streams])
    count = 2 + config.cost_critics * rule.costs
    critics = np.array([[nets.critic.initial(rng) for _ in range(count)] for rng in streams])
    log_temperature = np.full((len(seeds), LANES), math.log(config.initial_temperature), np.float32)
    return SACState(
        actor=actor,
        critics=critics,
        targets=critics.copy(),
        log_temperature=log_temperature,
        multipliers=lagrange.initial(rule.multipliers, config, len(seeds)),
        actor_moments=no_moments(actor),
        critic_moments=no_moments(critics),
        temperature_moments=no_moments(log_temperature),
    )


def check_rule(config: Any, rule: CostRule) -> None:
    """Raise ValueError if a function of a rule returns another shape than `CostRule` says, since
    sums would run over other axes. Each function is called once, with zeros. Raises UserError if
    PyTorch is used and batch_size does not fill its vector lanes: it computes a remainder
    differently, and the last bits of a run would depend on the runs beside it."""
    in_torch = not all(map(has_closed_form, (rule.risk, rule.critic_loss, rule.penalty)))
    if in_torch and config.batch_size % LANES:
        raise UserError(f"batch_size must be a multiple of {LANES}, got {config.batch_size}")
    runs, batch, costs = 2, 3, rule.costs
    critics = torch.zeros(runs, config.cost_critics, batch)
    rows, features = torch.zeros(runs, batch), torch.zeros(runs, batch, 1)
    drawn = Batch(features, features, rows, rows, features, rows, rows)
    multipliers = torch.zeros(runs, len(rule.multipliers))
    of_costs = torch.zeros(runs, costs, batch)
    returned = {
        "risk": (rule.risk(config, critics), (runs, batch)),
        "critic_loss": (rule.critic_loss(config, critics, critics, drawn), (runs,)),
        "penalty": (rule.penalty(config, of_costs, multipliers), of_costs.shape),
    }
    if rule.augmented:
        risks = torch.zeros(runs, costs)
        returned["augmented"] = rule.augmented(config, multipliers, risks), multipliers.shape
    for name, (value, shape) in returned.items():
        if (given := list(np.shape(value))) != list(shape):
            sizes = f"of {runs} runs, {batch} transitions, costs {costs}"
            sizes += f" and multipliers {len(rule.multipliers)}"
            raise ValueError(f"{name} must return {list(shape)}, got {given} ({sizes})")


class Sampled(NamedTuple):
    """Actions that a policy draws, and what their gradient needs, [A, R, B]: the action axis comes
    first, since NumPy is slow along a short last axis."""

    action: Float
    log_prob: Float
    """[R, B]"""
    spread: Float
    """`σ·noise`"""
    inside: NDArray[np.bool_]
    """Mask of the log-stds that were not clamped."""

    def slope(self, of_action: Float, of_log_prob: Float) -> Float:
        """Return the gradient of a loss in the outputs [R, B, 2·A] from its gradients in action
        [A, R, B] and log-probability [R, 1].

        `∂a/∂u = 1 - a²`, `∂ log π/∂u = 2 a`, `∂u/∂ log σ = σ·noise`, `∂ log π/∂ log σ = 2 a σ·noise
        - 1`.
        """
        in_u = of_action * (1.0 - self.action * self.action) + 2.0 * of_log_prob * self.action
        in_log_std = self.inside * (in_u * self.spread - of_log_prob)
        return np.concatenate([in_u, in_log_std]).transpose(1, 2, 0)


LOG_2, LOG_2_PI = math.log(2.0), math.log(2.0 * math.pi)


def sampled(outputs: Float, noise: Float) -> Sampled:
    """Return actions and their log-probabilities.

    outputs: mean and log-std from the policy network, [R, B, 2·A]; noise: standard normal,
    [R, B, A]. `a = tanh(u)`, `u = μ + σ·noise`, `log π = log N(u) - Σ log(1 - tanh²u)`. Source:
    Haarnoja et al. 2018, appendix C.
    """
    noise = noise.transpose(2, 0, 1)
    numbers = np.ascontiguousarray(outputs.transpose(2, 0, 1))
    mean, raw = numbers[: len(noise)], numbers[len(noise) :]
    log_std = np.minimum(np.maximum(raw, LOG_STD[0]), LOG_STD[1])  # `clip` takes twice as long
    spread = np.exp(log_std) * noise
    u = mean + spread
    # log(1 - tanh²u), without cancellation at large u
    size = np.abs(u)
    log_slope = 2.0 * (LOG_2 - size - np.log1p(np.exp(-2.0 * size)))
    log_prob = -0.5 * (noise * noise + LOG_2_PI) - log_std - log_slope
    return Sampled(np.tanh(u), np.add.reduce(log_prob), spread, log_std == raw)


class Critics(NamedTuple):
    """Values of all critics at some rows, and what their gradients need."""

    seen: Float
    """[R, B, critic inputs + A]"""
    tape: Any
    values: Float
    """[R, 2 + 2·C, B]"""


def critics_at(
    nets: Nets, critics: Float, observation: Float, action: Float, taped: bool = False
) -> Critics:
    """Evaluate all critics [R, 2 + 2·C, size] at observations [R, B, critic inputs] and actions
    [A, R, B]; taped: keep what `gradient_of` needs."""
    runs, count, size = critics.shape
    inputs = observation.shape[-1]
    seen = np.empty((*observation.shape[:2], inputs + len(action)), observation.dtype)
    seen[..., :inputs] = observation
    for column, of_one in enumerate(action, start=inputs):
        seen[..., column] = of_one
    params = critics.reshape(-1, size)
    own, what = kernel.of(params), (nets.critic, params, seen, count)
    found, tape = own.forward(*what) if taped else (own.values(*what), None)
    return Critics(seen, tape, found.reshape(runs, count, -1))


def gradient_of(nets: Nets, critics: Float, at: Critics, slope: Float, of: str) -> Float:
    """Return the gradient of a loss in the critics' parameters, [R, 2 + 2·C, size] (of "p"), or in
    the actions, [A, R, B] (of "x"); slope: its gradient in the critics' values, [R, 2 + 2·C, B]."""
    runs, count, size = critics.shape
    params, dy = critics.reshape(-1, size), slope.reshape(runs * count, -1, 1)
    own = kernel.of(params)
    in_params, in_seen = own.backward(nets.critic, params, at.seen, at.tape, dy, of, count)
    if in_params is not None:
        return in_params.reshape(critics.shape)
    assert in_seen is not None
    _, batch, width = in_seen.shape
    actions = in_seen.reshape(runs, count, batch, width)[..., -(nets.actor.sizes[-1] // 2) :]
    return np.ascontiguousarray(actions.transpose(3, 1, 0, 2)).sum(axis=1)


def of_costs(values: Float, rule: CostRule) -> list[Float]:
    """Return the outputs [R, 2, B] of each cost's critics, from those of all critics."""
    each = (values.shape[1] - 2) // max(rule.costs, 1)
    return [values[:, 2 + k * each : 2 + (k + 1) * each] for k in range(rule.costs)]


def risks(config: Any, rule: CostRule, values: Float) -> tuple[Float, list[Pull]]:
    """Return the risks [R, C, B] of all costs from the outputs of all critics, and their
    `Pull`s."""
    found = [pulled(rule.risk, config, own) for own in of_costs(values, rule)]
    columns = [values[:, :0], *(risk[:, None] for risk, _ in found)]
    return np.concatenate(columns, axis=1), [pull for _, pull in found]


def risk_at(
    nets: Nets,
    config: Any,
    rule: CostRule,
    state: SACState,
    observation: Float,
    noise: Float,
    weight: Float,
) -> Float:
    """Return the mean risk of each cost, [R, C], at observations [R, B, critic inputs] with new
    actions of the policy; noise: [R, B, action size]; weight: [R, B], sums to 1."""
    new = drawn(nets, state, observation, noise)
    at = critics_at(nets, state.critics, observation, new.action)
    return (weight[:, None] * risks(config, rule, at.values)[0]).sum(axis=-1)


def drawn(nets: Nets, state: SACState, observation: Float, noise: Float) -> Sampled:
    """Draw actions of the policy at observations [R, B, at least its inputs]."""
    seen = np.ascontiguousarray(observation[..., : nets.actor.sizes[0]])
    return sampled(kernel.of(state.actor).values(nets.actor, state.actor, seen), noise)


def shares(values: Float, sign: float) -> Float:
    """Return the slopes of the lower (sign 1) or the higher (-1) of two values in them, [R, 2, B]:
    1 for that one, 0 for the other, ½ for equal ones."""
    return 0.5 + (0.5 * sign) * np.sign(values[:, ::-1] - values)


def critic_slope(
    config: Any, rule: CostRule, found: Float, batch: Batch, target: Float, following: Float
) -> tuple[Float, dict[str, Float]]:
    """Return the gradient of the critics' losses in their values, [R, 2 + 2·C, B], and the losses.

    The losses, [R] each, are half the mean squared error of the reward critics, and the rule's loss
    of the cost critics. target: of the reward critics, [R, B]; following: values of the target
    networks at the next action, [R, 2 + 2·C, B].
    """
    error = found[:, :2] - target[:, None]
    one = np.ones(len(found), found.dtype)
    slopes, cost_part = [error / error.shape[-1]], np.zeros_like(one)
    pairs = zip(of_costs(found, rule), of_costs(following, rule), strict=True)
    for k, (own, theirs) in enumerate(pairs):
        of_cost = batch._replace(cost=batch.cost[:, k])
        loss, pull = pulled(rule.critic_loss, config, own, theirs, of_cost)
        cost_part = cost_part + loss
        slopes.append(pull(one))
    reward_part = 0.5 * mean(error * error).sum(axis=-1)
    records = {"critic_loss": reward_part, "cost_critic_loss": cost_part}
    return np.concatenate(slopes, axis=1), records


def actor_slope(
    config: Any, rule: CostRule, found: Float, multipliers: Float
) -> tuple[Float, Float, Float]:
    """Return the gradient of `E[-min Q + penalty(risk)]` in the critics' values [R, 2 + 2·C, B],
    that mean [R], and the mean risks [R, C]; multipliers: [R, M]."""
    batch = found.shape[-1]
    risk, pulls = risks(config, rule, found)
    penalty, pull = pulled(rule.penalty, config, risk, multipliers)
    in_risk = pull(np.full(risk.shape, 1.0 / batch, risk.dtype))
    slopes = [shares(found[:, :2], 1.0) / -batch]
    slopes += [pull(in_risk[:, k]) for k, pull in enumerate(pulls)]
    loss = penalty.sum(axis=1) - np.minimum(found[:, 0], found[:, 1])
    return np.concatenate(slopes, axis=1), mean(loss), mean(risk)


def mean(values: Float) -> Float:
    """Return the mean over the batch, the last axis."""
    return np.add.reduce(values, axis=-1) / values.shape[-1]


def actor_gradient(
    nets: Nets,
    config: Any,
    rule: CostRule,
    state: SACState,
    observation: Float,
    noise: Float,
    multipliers: Float,
) -> tuple[Float, Float, Float, Float]:
    """Return the gradient of `E[α log π - min Q + penalty(risk)]` in the actors [R, actor size],
    over new actions with that noise [R, B, A]; means of loss [R], risks [R, C], log π [R]."""
    own, alpha = kernel.of(state.actor), np.exp(state.log_temperature[:, :1])
    seen = np.ascontiguousarray(observation[..., : nets.actor.sizes[0]])
    outputs, tape = own.forward(nets.actor, state.actor, seen)
    new = sampled(outputs, noise)
    at = critics_at(nets, state.critics, observation, new.action, taped=True)
    slope, loss, risk = actor_slope(config, rule, at.values, multipliers)
    in_action = gradient_of(nets, state.critics, at, slope, "x")
    in_outputs = new.slope(in_action, alpha / seen.shape[1])
    log_prob = mean(new.log_prob)
    gradient, _ = own.backward(nets.actor, state.actor, seen, tape, in_outputs, "p")
    assert gradient is not None
    return gradient, loss + alpha[:, 0] * log_prob, risk, log_prob


@MAY_DIVERGE
def update(
    nets: Nets,
    config: Any,
    rule: CostRule,
    state: SACState,
    batch: Batch,
    noise: UpdateNoise,
    followed: Float | None = None,
    longest: NDArray[np.float64] | None = None,
) -> tuple[SACState, dict[str, Float]]:
    """Take one gradient step of critics, actor, temperature and multipliers, in this order.

    Losses are summed over runs and averaged over the batch. The critics' losses are those of
    `critic_slope` against `r + γ (min Q' - α log π)`, the actor's loss is
    `E[α log π - min Q + penalty(risk)]` over new actions. Temperature and multipliers are updated
    with the actions of the actor's step. followed: [R, C], what multipliers follow instead of the
    batch's risk; longest: [R], what the last multiplier follows in any case. Changes the arrays of
    the state in place, except those of multipliers. Returns the state with new multipliers, and
    records, means over the batch: [R], multipliers [R, M], and the risks that are followed [R, C].
    """
    own, rate, count = kernel.of(state.actor), config.learning_rate, len(state.actor)
    temperature = np.exp(state.log_temperature)
    alpha = temperature[:, :1]
    following = drawn(nets, state, batch.next_observation, noise.next_action)
    later = critics_at(nets, state.targets, batch.next_observation, following.action).values
    value = np.minimum(later[:, 0], later[:, 1]) - alpha * following.log_prob
    target = batch.reward + config.discount * (1.0 - batch.terminal) * value

    taken = batch.action.transpose(2, 0, 1)
    at = critics_at(nets, state.critics, batch.observation, taken, taped=True)
    slope, metrics = critic_slope(config, rule, at.values, batch, target, later)
    gradient = gradient_of(nets, state.critics, at, slope, "p")
    own.adam(state.critics, gradient, state.critic_moments, rate)
    del at

    multipliers = in_penalty = lagrange.values(rule.multipliers, state.multipliers, count)
    if rule.augmented and rule.augments_replay and followed is None:
        at = critics_at(nets, state.critics, batch.observation, taken)
        followed = mean(risks(config, rule, at.values)[0])
    if rule.augmented and followed is not None:
        in_penalty = array(rule.augmented(config, tensor(multipliers), tensor(followed)))

    what = (state, batch.observation, noise.new_action, in_penalty)
    gradient, loss, risk, log_prob = actor_gradient(nets, config, rule, *what)
    own.adam(state.actor, gradient, state.actor_moments, config.policy_lr or rate)

    risk = risk if followed is None else followed
    if longest is not None:
        risk = np.concatenate([risk[:, :-1], longest[:, None].astype(risk.dtype)], axis=1)
    metrics |= {
        "actor_loss": loss,
        "temperature": temperature[:, 0],
        "multipliers": multipliers,
        "risks": risk,
        "entropy": -log_prob,
    }
    # Descend `-α E[log π + target entropy]` in log α, with the target entropy -A.
    of_temperature = temperature * (len(taken) - log_prob[:, None])
    moments = state.temperature_moments
    own.adam(state.log_temperature, of_temperature, moments, config.temperature_lr)
    change = state.critics - state.targets
    change *= config.target_rate
    np.add(state.targets, change, out=state.targets)
    if all(isinstance(part, MultiplierState) for part in state.multipliers):
        states = lagrange.follow(rule.multipliers, config, state.multipliers, risk)
        state = state._replace(multipliers=states)  # a PID follows once per epoch
    return state, metrics
