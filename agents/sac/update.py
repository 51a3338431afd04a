"""The update that the SAC family shares: SAC with two reward critics and two cost critics.

An algorithm adds a `CostRule`. Losses are summed over runs and averaged over the batch, so
the gradient of one run does not see the others. Source: Haarnoja et al. 2018 ("Soft actor-critic
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
from torch.nn.functional import softplus

from agents.checks import In
from agents.errors import UserError
from agents.lockstep import kernel, lagrange, tree
from agents.lockstep.backend import tensor
from agents.lockstep.kernel import Float
from agents.lockstep.lagrange import Multiplier, MultiplierConfig, MultiplierState, State
from agents.lockstep.nets import (
    LANES,
    MAY_DIVERGE,
    MLP,
    Activation,
    Moments,
    adam_in_place,
    check_batch,
    no_moments,
)
from agents.lockstep.noise import Purpose, stream
from agents.lockstep.normalizer import InputConfig
from agents.lockstep.rollout import critic_inputs
from agents.sac.replay import Batch

TimeLimit = Literal["bootstrap", "terminal", "terminal_cost"]


@dataclass(frozen=True)
class SACConfig(InputConfig):
    """Hyper-parameters of the SAC family.

    The defaults are the paper's (table HP_Circle2D) but for the time limit; presets set it for
    Circle2D.
    """

    cost_critics = 2  # of each cost; an algorithm with an ensemble makes it a hyper-parameter

    discount: Annotated[float, In(0, 1)] = 0.99
    """Discount factor γ of rewards and costs, in [0, 1]. Paper: 0.99."""
    learning_rate: Annotated[float, In(above=0, high=1)] = 3e-4
    """Adam's step size for actor and critics. Paper: 3e-4."""
    temperature_lr: Annotated[float, In(above=0, high=1)] = 3e-4
    """Adam's step size for the temperature, which falls from 1 as the policy gets surer. Paper:
    3e-4, as for the networks."""
    batch_size: Annotated[int, In(1)] = 256
    """Transitions a gradient step; a multiple of 32, at most the replay's size. Paper: 256."""
    gradient_steps: Annotated[int, In(1, 100_000)] = 5
    """Gradient steps an epoch, which is one episode. Paper: 5."""
    random_steps: Annotated[int, In(0)] = 5_000
    """Environment steps at the start that take uniformly random actions. Paper: 5000 on Circle2D,
    50000 on Safety-Gymnasium."""
    random_exponent: Annotated[float, In(0, 4)] = 0.0
    """Exponent β of the random actions' power spectrum 1/f^β: 0 white, 1 pink, 2 brown noise, which
    keeps a direction for many steps. Each action is uniform by itself. Paper: white, as usual."""
    replay_size: Annotated[int, In(1)] = 50_000
    """Transitions the replay of a run holds. Paper: 50000 on Circle2D, 500000 on
    Safety-Gymnasium."""
    hidden: Annotated[tuple[int, ...], In(1, 65_536)] = (64, 64)
    """Sizes of the hidden layers of actor and critics. Paper: 64, 64."""
    activation: Activation = "tanh"
    """Function between the layers. Not printed in the paper; tanh."""
    input_scale: Annotated[float | tuple[float, ...], In(1e-6, 1e6)] = 1.0
    """Factor on observations before the networks, or one for each number of an observation. Small
    tanh networks are smooth: observations in [-1, 1] whose details matter want a larger one. Not in
    the paper; 1 leaves them as they are."""
    normalize_observations: bool = False
    """Whether networks see each number of an observation less its mean and over its standard
    deviation, both of all that the run has seen in the epochs before, clipped at ±10. Not in the
    paper; in OmniSafe by default."""
    target_rate: Annotated[float, In(0, 1)] = 0.005
    """Share τ by which the target critics follow. Not printed in the paper; 0.005 as in Haarnoja et
    al."""
    time_limit: TimeLimit = "bootstrap"
    """Whether to bootstrap at the time limit: bootstrap (reward and cost), terminal (neither), or
    terminal_cost (reward only). Not printed in the paper; the presets of Circle2D have
    terminal."""
    reward_scale: Literal["none", "running"] = "none"
    """Scale of the learned reward: none, or running: over the standard deviation of the discounted
    return so far, cut at ±10. Records keep the plain reward. Not in the paper; none."""
    random_share: Annotated[float, In(0, 1)] = 0.0
    """Share of each batch that is drawn from the random actions at the start, in [0, 1]; above 0
    the replay keeps these to the end. Not in the paper; 0: none."""
    novelty_bonus: Annotated[float, In(0, 1e6)] = 0.0
    """Bonus, in units of reward, on the learned reward for reaching states that are new to the run:
    about `novelty_bonus / √(1 + n)` after n visits. Records keep the plain reward. Not in the
    paper; 0: none."""
    novelty_length: Annotated[float, In(1e-6, 1e6)] = 2.0
    """Distance over which states count as the same place for the bonus, in the units of the
    networks' inputs: observations times `input_scale`. Not in the paper."""

    def __post_init__(self) -> None:
        """Raises UserError naming the value that is not allowed."""
        super().__post_init__()
        check_batch(self.batch_size)
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

    The default is that of the paper's other tasks; presets set it for Circle2D.
    """

    cost_limit: Annotated[float, In(0, 1e9)] = 25.0
    """Limit d of the discounted cost return Q_c that the cost critics estimate, with the discount γ
    of the rewards; not of an episode's cost. Paper: 5 on Circle2D, 25 on Safety-Gymnasium."""
    limit_of: Literal["discounted", "episode"] = "discounted"
    """Whether the limit is Q_c's (discounted), or that of an episode's cost (episode): Q_c is then
    limited by `d (1 - γ^T) / ((1 - γ) T)`, T steps being the task's time limit, as in Ray's and
    Yang's code. Not printed in the paper; discounted."""
    streak_weight: Annotated[float, In(0, 1e6)] = 0.0
    """Weight β ≥ 0 of streaks in the cost that is learned and limited: the k-th consecutive cost
    step costs `1 + β (k - 1)` times, and the critics see k. Records keep the plain cost. Not in the
    paper; 0: none."""

    @property
    def limited_cost(self) -> str:
        """The limited cost in words, for tables."""
        converted = ", converted from an episode's cost," if self.limit_of == "episode" else ""
        return f"discounted cost return Q_c{converted}"


@dataclass(frozen=True)
class MultiplierOfConfig(MultiplierConfig, ConstrainedSACConfig):
    """Hyper-parameters of the SAC family's algorithms that have a multiplier."""

    multiplier_of: Literal["replay", "start", "episode"] = "replay"
    """What the multiplier follows: the risk at the states of the replay, most of which lie behind
    the start of an episode (replay; as in the algorithms' papers), the risk at start states of the
    last 64 episodes (start), or the undiscounted cost of the last 10 episodes, whose limit
    `cost_limit` then is (episode; as in OmniSafe and FSRL). Not printed in the paper; replay."""

    @property
    def limited_cost(self) -> str:
        """The limited cost in words, for tables."""
        of_episode = self.multiplier_of == "episode"
        return "undiscounted cost of an episode" if of_episode else super().limited_cost


LOG_STD = (-20.0, 2.0)
"""Where the logarithm of the standard deviation is clamped."""


def sample(outputs: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
    """Actions and their log-probabilities.

    outputs: mean and log-std of the policy net, [R, B, 2·A]; noise: standard normal, [R, B, A]
    -> [R, B, A] in (-1, 1), [R, B]. `a = tanh(u)`, `u = μ + σ·noise`,
    `log π = log N(u) - Σ log(1 - tanh²u)`. Source: Haarnoja et al. 2018, appendix C.
    """
    mean, log_std = outputs.chunk(2, dim=-1)
    log_std = log_std.clamp(*LOG_STD)
    u = mean + log_std.exp() * noise
    log_normal = -0.5 * noise * noise - log_std - 0.5 * math.log(2.0 * math.pi)
    # log(1 - tanh²u) without the cancellation at large u
    log_slope = 2.0 * (math.log(2.0) - u - softplus(-2.0 * u))
    return torch.tanh(u), (log_normal - log_slope).sum(dim=-1)


def act(outputs: NDArray[np.float32], noise: NDArray[np.float32] | None) -> NDArray[np.float32]:
    """The actions of `sample` in numpy; without noise the deterministic policy's, `tanh(μ)`."""
    half = outputs.shape[-1] // 2
    mean, log_std = outputs[..., :half], outputs[..., half:]
    if noise is None:
        return np.tanh(mean)
    log_std = np.minimum(np.maximum(log_std, LOG_STD[0]), LOG_STD[1])
    return np.tanh(mean + np.exp(log_std) * noise)


def mean_cost(config: Any, costs: NDArray[np.float64]) -> float:
    """The mean of the costs of episodes [E]."""
    return float(costs.mean())


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
    limits: tuple[str, ...] = ("cost_limit",)
    """Names of the hyper-parameters that limit the costs, in their order; a multiplier names that
    of its cost itself."""
    augmented: Callable[[Any, Tensor, Tensor], Tensor] | None = None
    """(config, multipliers [R, M], what they follow [R, C]) -> [R, M]: the multipliers that the
    penalty sees. Where it is given and `multiplier_of` is replay, multipliers follow the mean risk
    at the batch's own actions, instead of that at new actions of the policy."""
    augments_replay: bool = True
    """Whether `augmented` is there for multipliers that follow the replay, too."""
    of_episodes: Callable[[Any, NDArray[np.float64]], float] = mean_cost
    """(config, a cost of recent episodes [E]) -> what a multiplier of `multiplier_of` episode
    follows."""


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
    start_action: Any = None
    """[R, STARTS, action size], with `multiplier_of` start"""


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


def check_rule(config: Any, rule: CostRule) -> None:
    """Raise ValueError where a function of a rule returns another shape than `CostRule` says: sums
    would run over other axes. Each is called once, with zeros."""
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


def values(nets: Nets, critics: Tensor, observation: Tensor, action: Tensor) -> Tensor:
    """Values of all critics of each run: [R, 2 + 2·C, B]."""
    return nets.critic.forward_each(critics, torch.cat([observation, action], dim=-1))


def risk_at(
    nets: Nets,
    config: Any,
    rule: CostRule,
    state: SACState,
    observation: Tensor,
    noise: Tensor,
    weight: Tensor,
) -> Tensor:
    """The mean risk of each cost where the policy acts anew at observations [R, B, critic inputs]:
    [R, C]; noise: [R, B, action size]; weight: [R, B], adds up to 1."""
    outputs = nets.actor.forward(state.actor, nets.actor.inputs_of(observation))
    q = values(nets, state.critics, observation, sample(outputs, noise)[0])
    return (weight[:, None] * risks(config, rule, q)).sum(dim=-1)


def cost_critics(values: Tensor, rule: CostRule) -> list[Tensor]:
    """The outputs [R, 2, B] of each cost's critics among those of all critics."""
    return list(values[:, 2:].chunk(rule.costs, dim=1))


def risks(config: Any, rule: CostRule, values: Tensor) -> Tensor:
    """The risk of each cost, [R, C, B], from the outputs of all critics."""
    return torch.stack([rule.risk(config, own) for own in cost_critics(values, rule)], dim=1)


class Critics(NamedTuple):
    """What all critics say of some rows, and what their gradients need."""

    seen: Float
    """[R, B, critic inputs + A]"""
    tape: Any
    values: Tensor
    """[R, 2 + 2·C, B]"""


def critics_at(nets: Nets, critics: Tensor, observation: Tensor, action: Float) -> Critics:
    """All critics [R, 2 + 2·C, size] at observations [R, B, critic inputs] and actions
    [R, B, A]."""
    runs, count, size = critics.shape
    seen = np.concatenate([observation.numpy(), action], axis=-1)
    params = critics.numpy().reshape(-1, size)
    found, tape = kernel.of(params).forward(nets.critic, params, seen, count)
    return Critics(seen, tape, tensor(found.reshape(runs, count, -1)))


def pulled(nets: Nets, critics: Tensor, at: Critics, slope: Float, of: str) -> Float:
    """The gradient of a loss in the critics' parameters, [R, 2 + 2·C, size] (of "p"), or in the
    actions, [R, B, A] (of "x"); slope: in their values, [R, 2 + 2·C, B]."""
    runs, count, size = critics.shape
    params = critics.numpy().reshape(-1, size)
    dy = slope.reshape(runs * count, -1, 1)
    of_params, of_inputs = kernel.of(params).backward(
        nets.critic, params, at.seen, at.tape, dy, of, count
    )
    if of_params is not None:
        return of_params.reshape(critics.shape)
    assert of_inputs is not None
    _, batch, width = of_inputs.shape
    actions = slice(nets.critic.sizes[0] - nets.actor.sizes[-1] // 2, None)
    return of_inputs.reshape(runs, count, batch, width)[..., actions].sum(axis=1)


def critic_slope(
    config: Any,
    rule: CostRule,
    found: Tensor,
    batch: Batch,
    reward_target: Float,
    following: Tensor,
) -> tuple[Float, dict[str, Tensor]]:
    """The gradient in the critics' values [R, 2 + 2·C, B] of half the mean squared error of each
    reward critic and the rule's loss of the cost critics, and both parts [R].

    following: the target critics' values at the next action, [R, 2 + 2·C, B].
    """
    error = found[:, :2].numpy() - reward_target[:, None]
    slope = np.empty(found.shape, error.dtype)
    slope[:, :2] = error / error.shape[-1]
    reward_part = 0.5 * (error * error).mean(axis=-1).sum(axis=-1)
    with torch.enable_grad():
        costs = found[:, 2:].detach().requires_grad_()
        pairs = zip(costs.chunk(rule.costs, 1), cost_critics(following, rule), strict=True)
        losses = [
            rule.critic_loss(config, own, theirs, batch._replace(cost=batch.cost[:, k]))
            for k, (own, theirs) in enumerate(pairs)
        ]
        cost_part = sum(losses[1:], start=losses[0])
    slope[:, 2:] = torch.autograd.grad(cost_part.sum(), costs)[0].numpy()
    return slope, {"critic_loss": tensor(reward_part), "cost_critic_loss": cost_part.detach()}


def actor_slope(
    config: Any, rule: CostRule, found: Tensor, multipliers: Tensor
) -> tuple[Float, Tensor, Tensor]:
    """The gradient of `E[-min Q + penalty(risk)]` in the critics' values [R, 2 + 2·C, B], that mean
    without its gradient [R], and the risks [R, C, B]; multipliers: [R, M]."""
    with torch.enable_grad():
        leaf = found.detach().requires_grad_()
        risk = risks(config, rule, leaf)
        penalty = rule.penalty(config, risk, multipliers).sum(dim=1)
        loss = (penalty - torch.minimum(leaf[:, 0], leaf[:, 1])).mean(dim=-1)
    (slope,) = torch.autograd.grad(loss.sum(), leaf)
    return slope.numpy(), loss.detach(), risk.detach()


class Sampled(NamedTuple):
    """`sample` in numpy, with what its gradient needs."""

    action: Float
    """[R, B, A]"""
    log_prob: Float
    """[R, B]"""
    outputs: Float
    """Of the policy net, [R, B, 2·A]"""
    spread: Float
    """`σ·noise`, [R, B, A]"""

    def slope(self, of_action: Float, of_log_prob: Float) -> Float:
        """The gradient of a loss in the outputs, from those in action [R, B, A] and
        log-probability [R, B, 1].

        `∂a/∂u = 1 - a²`, `∂ log π/∂u = 2 a`, `∂u/∂ log σ = σ·noise`, `∂ log π/∂ log σ = 2 a σ·noise
        - 1`.
        """
        in_u = of_action * (1.0 - self.action * self.action) + of_log_prob * 2.0 * self.action
        raw = self.outputs[..., self.action.shape[-1] :]
        inside = (raw >= LOG_STD[0]) & (raw <= LOG_STD[1])
        return np.concatenate([in_u, inside * (in_u * self.spread - of_log_prob)], axis=-1)


LOG_2, LOG_2_PI = math.log(2.0), math.log(2.0 * math.pi)


def sampled(outputs: Float, noise: Float) -> Sampled:
    """See `sample`; outputs: [R, B, 2·A]; noise: [R, B, A]."""
    half = outputs.shape[-1] // 2
    log_std = np.minimum(np.maximum(outputs[..., half:], LOG_STD[0]), LOG_STD[1])
    spread = np.exp(log_std) * noise
    u = outputs[..., :half] + spread
    log_slope = 2.0 * (LOG_2 - u - np.logaddexp(0.0, -2.0 * u))
    log_prob = (-0.5 * (noise * noise + LOG_2_PI) - log_std - log_slope).sum(axis=-1)
    return Sampled(np.tanh(u), log_prob, outputs, spread)


def actor_gradient(
    nets: Nets,
    config: Any,
    rule: CostRule,
    state: SACState,
    observation: Tensor,
    noise: Tensor,
    multipliers: Tensor,
) -> tuple[Float, Tensor, Tensor, Float]:
    """The gradient of `E[α log π - min Q + penalty(risk)]` in the actors [R, actor size], over
    actions drawn anew with that noise [R, B, A]; the loss [R], risks [R, C, B], log π [R, B]."""
    actor, alpha = state.actor.numpy(), state.log_temperature.exp()[:, :1]
    seen, own = nets.actor.inputs_of(observation).numpy(), kernel.of(actor)
    outputs, tape = own.forward(nets.actor, actor, seen)
    new = sampled(outputs, noise.numpy())
    at = critics_at(nets, state.critics, observation, new.action)
    slope, loss, risk = actor_slope(config, rule, at.values, multipliers)
    of_log_prob = (alpha.numpy() / seen.shape[1])[..., None]
    in_outputs = new.slope(pulled(nets, state.critics, at, slope, "x"), of_log_prob)
    gradient, _ = own.backward(nets.actor, actor, seen, tape, in_outputs, "p")
    assert gradient is not None
    loss = loss + alpha[:, 0] * tensor(new.log_prob.mean(axis=-1))
    return gradient, loss, risk, new.log_prob


@MAY_DIVERGE
def update(
    nets: Nets,
    config: Any,
    rule: CostRule,
    state: SACState,
    batch: Batch,
    noise: UpdateNoise,
    followed: Tensor | None = None,
) -> tuple[SACState, dict[str, Tensor]]:
    """One gradient step of critics, actor, temperature and multiplier, in this order.

    Losses are summed over runs and averaged over the batch: the critics' are those of
    `critic_slope` against `r + γ (min Q' - α log π)`, the actor's is `E[α log π - min Q +
    penalty(risk)]` over actions drawn anew. Networks are the kernel's; a rule is differentiated in
    the critics' values. Temperature and multiplier see the actions that the actor's step was
    computed from; followed: [R, C], what multipliers follow instead of the batch's risk. Returns
    the new state and, for the records, means over the batch: [R], multipliers [R, M], risks, those
    that are followed [R, C].
    """
    rate = config.learning_rate
    after = state._replace(**{k: tree.copy(getattr(state, k)) for k in LEARNED})
    temperature = state.log_temperature.exp()
    alpha = temperature.numpy()[:, :1]
    own, actor = kernel.of(state.actor.numpy()), after.actor.numpy()

    seen = nets.actor.inputs_of(batch.next_observation).numpy()
    outputs, _ = own.forward(nets.actor, actor, seen)
    following = sampled(outputs, noise.next_action.numpy())
    targets = critics_at(nets, state.targets, batch.next_observation, following.action).values
    low = np.minimum(*targets[:, :2].numpy().swapaxes(0, 1))
    going = config.discount * (1.0 - batch.terminal.numpy())
    target = batch.reward.numpy() + going * (low - alpha * following.log_prob)

    at = critics_at(nets, after.critics, batch.observation, batch.action.numpy())
    slope, metrics = critic_slope(config, rule, at.values, batch, target, targets)
    gradient = pulled(nets, after.critics, at, slope, "p")
    adam_in_place(after.critics, gradient, after.critic_moments, rate)

    multipliers = in_penalty = lagrange.values(rule.multipliers, state.multipliers, len(alpha))
    if rule.augmented and rule.augments_replay and followed is None:
        taken = critics_at(nets, after.critics, batch.observation, batch.action.numpy())
        followed = risks(config, rule, taken.values).mean(dim=-1)
    if rule.augmented and followed is not None:
        in_penalty = rule.augmented(config, multipliers, followed)

    what = (after, batch.observation, noise.new_action, in_penalty)
    gradient, loss, risk, log_prob = actor_gradient(nets, config, rule, *what)
    adam_in_place(after.actor, gradient, after.actor_moments, rate)

    risk = risk.mean(dim=-1) if followed is None else followed
    entropy = -log_prob.mean(axis=-1)
    metrics |= {
        "actor_loss": loss,
        "temperature": temperature[:, 0],
        "multipliers": multipliers,
        "risks": risk,
        "entropy": tensor(entropy),
    }
    # Descend `-α E[log π + target entropy]` along log α, with the target entropy -A.
    excess = tensor(-entropy)[:, None] - batch.action.shape[-1]
    of_temperature = (-temperature * excess).numpy()
    moments = after.temperature_moments
    adam_in_place(after.log_temperature, of_temperature, moments, config.temperature_lr)
    after.targets.lerp_(after.critics, config.target_rate)
    if all(isinstance(part, MultiplierState) for part in state.multipliers):
        states = lagrange.follow(rule.multipliers, config, state.multipliers, risk)
        after = after._replace(multipliers=states)  # a PID follows once an epoch
    return after, metrics


LEARNED = ("actor", "critics", "targets", "log_temperature")
LEARNED += ("actor_moments", "critic_moments", "temperature_moments")
"""Parts of the state that an update changes in place, in a copy."""
