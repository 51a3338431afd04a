"""The update that the on-policy family shares: a trust-region step of the policy, then the critics.

What an algorithm adds is a `StepRule`. Source: Schulman et al. 2015, "Trust region policy
optimization", with the cost terms of the algorithm's paper.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor

from agents.errors import check, check_choice, check_integers
from agents.lockstep import multiplier
from agents.lockstep.adam import Moments, no_moments
from agents.lockstep.backend import tensor
from agents.lockstep.compiling import compiled
from agents.lockstep.multiplier import Multiplier
from agents.lockstep.nets import MLP, check_lanes
from agents.lockstep.noise import Purpose, stream
from agents.on_policy.gaussian import Gaussian, GaussianPolicy
from agents.on_policy.packing import blocks
from agents.trust_region.natural_gradient import Problem, Step, conjugate_gradient, line_search


@dataclass(frozen=True)
class TRPOConfig:
    """Hyper-parameters of the on-policy family.

    The defaults are the paper's (table HP_Circle2D) but for the cost limit, 25 as on its other
    tasks; presets set it for Circle2D.
    """

    cost_limit: float = 25.0
    """Limit d of the cost of an episode. Paper: 5 on Circle2D, 25 on Safety-Gymnasium."""
    discount: float = 0.99
    """Discount factor γ of rewards and costs, in [0, 1]. Paper: 0.99."""
    gae_lambda: float = 0.95
    """Weight λ of longer returns in advantages (GAE), in [0, 1]. Paper: 0.95."""
    episodes: int = 10
    """Whole episodes an epoch. Paper: 10; 20 on SafetyPointCircle1."""
    target_kl: float = 0.01
    """Largest mean KL divergence δ of a step of the policy. Paper: 0.01."""
    cg_iterations: int = 15
    """Iterations of conjugate gradients. Paper: 15."""
    cg_damping: float = 0.1
    """Added to the diagonal of the KL divergence's Hessian. Not printed in the paper; 0.1 as in
    Stable-Baselines3."""
    line_search_steps: int = 15
    """Lengths of a step that are tried at most. Paper: 15."""
    line_search_decay: float = 0.8
    """Factor between the lengths tried, in (0, 1]. Not printed in the paper; 0.8 as in
    Stable-Baselines3."""
    learning_rate: float = 3e-4
    """Adam's step size for the critics. Paper: 3e-4."""
    critic_iterations: int = 10
    """Passes of the critics over an epoch's steps. Paper: 10."""
    batch_size: int = 256
    """Steps in a minibatch of the critics; a multiple of 32. Paper: 256."""
    hidden: tuple[int, ...] = (64, 64)
    """Sizes of the hidden layers of actor and critics (tanh); multiples of 32. Paper: 64, 64."""
    initial_log_std: float = 0.0
    """Initial logarithm of the policy's standard deviation. Not printed in the paper; 0 as in
    Stable-Baselines3."""
    time_limit: Literal["bootstrap", "terminal"] = "bootstrap"
    """Whether values go on behind a time limit. Not printed in the paper."""

    def __post_init__(self) -> None:
        """Raises UserError naming the value that is not allowed."""
        check_integers(self, "episodes", "cg_iterations", "line_search_steps", low=1)
        check_integers(self, "critic_iterations", "batch_size", low=1)
        check(self, "cost_limit", "cg_damping", low=0)
        check(self, "discount", "gae_lambda", low=0, high=1)
        check(self, "learning_rate", "line_search_decay", above=0, high=1)
        check(self, "target_kl", low=1e-8, high=10)
        check(self, "initial_log_std")
        check_lanes(self)
        check_choice(self, "time_limit", "bootstrap", "terminal")


class StepRule(NamedTuple):
    """What an algorithm of the family does with costs. Every function takes its config first."""

    objective: Callable[[Any, Tensor, Tensor, Tensor], Tensor]
    """(config, reward advantages [R, B], cost advantages [R, B], multiplier [R, 1]) -> [R, B]: the
    advantages that the policy's step raises. The multiplier is 0 where the rule has none."""
    step: Callable[[Any, Problem], Step]
    """(config, problem) -> the step that is tried."""
    multiplier: multiplier.Form | None = None
    """What the multiplier is; it ascends on `J_C - d`. None for an algorithm without one."""
    has_cases: bool = False
    """Whether `Step.case` is worth recording."""


class TRPOState(NamedTuple):
    """Everything an update reads and writes."""

    actor: Tensor
    """[R, actor size]"""
    critics: Tensor
    """[R, 2, critic size]: of the reward, of the cost"""
    critic_moments: Moments
    multiplier: Multiplier | None


class Epoch(NamedTuple):
    """The steps of an epoch, run by run: see `packing`."""

    observation: Tensor
    """[R, B, observation size]"""
    action: Tensor
    """[R, B, A]"""
    weight: Tensor
    """[R, B]: adds up to 1"""
    reward_advantage: Tensor
    """[R, B], standardised"""
    cost_advantage: Tensor
    """[R, B], centred"""
    value_targets: Tensor
    """[R, 2, B]: of the reward, of the cost"""
    length: Tensor
    """[R]: mean length of the episodes"""
    excess: Tensor
    """[R]: mean undiscounted cost of the episodes above the limit"""


class Nets(NamedTuple):
    """The shapes of the networks."""

    actor: GaussianPolicy
    critic: MLP


def make_nets(config: TRPOConfig, observation_size: int, action_size: int) -> Nets:
    """Nets for flat observations and actions."""
    return Nets(
        actor=GaussianPolicy(MLP((observation_size, *config.hidden, action_size))),
        critic=MLP((observation_size, *config.hidden, 1)),
    )


def initial_state(nets: Nets, config: Any, rule: StepRule, seeds: Sequence[int]) -> TRPOState:
    """The state of runs before their first update; each run's comes from its seed alone."""
    streams = [stream(seed, Purpose.PARAMETERS) for seed in seeds]
    actor = np.stack([nets.actor.initial(rng, config.initial_log_std) for rng in streams])
    critics = np.array([[nets.critic.initial(rng) for _ in range(2)] for rng in streams])
    critics = tensor(critics)
    return TRPOState(
        tensor(actor),
        critics,
        no_moments(critics),
        multiplier.initial(rule.multiplier, config, len(seeds)),
    )


class Block(NamedTuple):
    """Steps of an epoch, and what the policy that took them says of them."""

    observation: Tensor
    """[R, BLOCK, observation size]"""
    action: Tensor
    """[R, BLOCK, A]"""
    weight: Tensor
    """[R, BLOCK]"""
    gains: Tensor
    """[R, 2, BLOCK]: advantages of the objective and of the cost"""
    old: Gaussian
    """The policy before its step."""
    old_log_prob: Tensor
    """[R, BLOCK]"""


def blocks_of(nets: Nets, actor: Tensor, epoch: Epoch, objective: Tensor) -> list[Block]:
    """The epoch's steps under the policy that took them; objective: advantages [R, B]."""
    columns = (epoch.observation, epoch.action, epoch.weight, objective, epoch.cost_advantage)
    found = []
    for observation, action, weight, of_objective, of_cost in blocks(*columns):
        old = nets.actor.distribution(actor, observation)
        gains = torch.stack((of_objective, of_cost), dim=1)
        found.append(Block(observation, action, weight, gains, old, old.log_prob(action)))
    return found


@compiled
def fisher_in(nets: Nets, actor: Tensor, block: Block, v: Tensor) -> Tensor:
    """`Jᵀ M J v` of a block, J the Jacobian of mean and log-std, and M the Fisher information of a
    Gaussian in them: `1/σ²` and 2. All [R, actor size].
    """

    def parameters(params: Tensor) -> Tensor:
        policy = nets.actor.distribution(params, block.observation)
        return torch.cat([policy.mean, policy.log_std.expand_as(policy.mean)], dim=-1)

    outputs, pull, *_ = torch.func.vjp(parameters, actor)
    # J v is the gradient in u of `Jᵀ u · v`; forward mode gives the same, slower.
    _, push, *_ = torch.func.vjp(lambda u: pull(u)[0], torch.zeros_like(outputs))
    variance = block.old.std * block.old.std
    information = torch.cat([1.0 / variance, torch.full_like(variance, 2.0)], dim=-1)
    return pull(push(v)[0] * (block.weight[..., None] * information))[0]


def fisher_product(
    nets: Nets, actor: Tensor, steps: list[Block], damping: float
) -> Callable[[Tensor], Tensor]:
    """v -> H v for the Hessian of the mean KL divergence at the policy itself, plus the damping."""
    return lambda v: sum((fisher_in(nets, actor, block, v) for block in steps), start=damping * v)


@compiled
def compared_in(nets: Nets, actor: Tensor, block: Block) -> tuple[Tensor, Tensor]:
    """What `compared` adds up over blocks."""
    policy = nets.actor.distribution(actor, block.observation)
    held = block.weight > 0  # elsewhere a sharp policy may give infinity, and 0 · ∞ is NaN
    change = torch.where(held, policy.log_prob(block.action) - block.old_log_prob, 0.0)
    weighted = (block.weight * change.exp())[:, None] * block.gains
    divergence = torch.where(held, block.old.kl(policy), 0.0)
    return weighted.sum(dim=-1), (block.weight * divergence).sum(dim=-1)


def compared(nets: Nets, actor: Tensor, steps: list[Block]) -> tuple[Tensor, Tensor]:
    """A policy against the one before: `E[π(a|s) / π_old(a|s) · A]` for the objective and the cost,
    [R, 2], and the mean KL divergence from the old to the new one, [R]."""
    surrogates, kl = torch.zeros(len(actor), 2), torch.zeros(len(actor))
    for block in steps:
        of_block, kl_of_block = compared_in(nets, actor, block)
        surrogates, kl = surrogates + of_block, kl + kl_of_block
    return surrogates, kl


@compiled
def gradient_in(nets: Nets, actor: Tensor, block: Block, of: int) -> Tensor:
    """A block's part of the gradient of `compared`'s surrogate `of`, [R, actor size]."""
    return torch.func.grad(lambda params: compared_in(nets, params, block)[0][:, of].sum())(actor)


def policy_step(
    nets: Nets, config: Any, rule: StepRule, state: TRPOState, epoch: Epoch
) -> tuple[Tensor, dict[str, Tensor]]:
    """The policy after the rule's step and its line search -> [R, actor size], records [R]."""
    old = state.actor
    factor = multiplier.value(rule.multiplier, state.multiplier, len(old))
    objective = rule.objective(config, epoch.reward_advantage, epoch.cost_advantage, factor)
    steps = blocks_of(nets, old, epoch, objective)

    def gradient(of: int) -> Tensor:
        return sum(
            (gradient_in(nets, old, block, of) for block in steps), start=torch.zeros_like(old)
        )

    product = fisher_product(nets, old, steps, config.cg_damping)
    problem = Problem(
        gradient=gradient(0),
        cost_gradient=lambda: gradient(1) * epoch.length[:, None],
        excess=epoch.excess,
        product=product,
        solve=lambda b: conjugate_gradient(product, b, config.cg_iterations),
        target_kl=config.target_kl,
    )
    step = rule.step(config, problem)
    before, _ = compared(nets, old, steps)

    def judge(actor: Tensor) -> tuple[Tensor, Tensor]:
        after, kl = compared(nets, actor, steps)
        growth, cost_growth = (after - before).unbind(dim=-1)
        allowed = (kl <= config.target_kl) & ((growth > 0) | ~step.must_improve)
        allowed &= cost_growth * epoch.length <= step.cost_bound
        return allowed | (epoch.length == 0), kl  # nobody waits for a run that takes no part

    found = line_search(old, step.step, judge, config.line_search_steps, config.line_search_decay)
    records = {"kl": found.kl, "step_scale": found.scale, "case": step.case.float()}
    return found.params, records | {"multiplier": factor[:, 0]}
