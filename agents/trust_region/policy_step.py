"""The trust-region step of the policy: natural gradient and line search.

An algorithm adds a `StepRule`. Source: Schulman et al. 2015, "Trust region policy
optimization", with the cost terms of the algorithm's paper.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import torch
from torch import Tensor

from agents.checks import In
from agents.lockstep import lagrange
from agents.lockstep.compiling import compiled
from agents.lockstep.lagrange import Multiplier
from agents.on_policy.comparison import Block, blocks_of, compared, compared_in
from agents.on_policy.state import EpisodeCostLimit, Epoch, Nets, OnPolicyConfig, OnPolicyState
from agents.trust_region.natural_gradient import Problem, Step, conjugate_gradient, line_search


@dataclass(frozen=True)
class TRPOConfig(EpisodeCostLimit, OnPolicyConfig):
    """Hyper-parameters of the trust-region family.

    The defaults are the paper's (table HP_Circle2D) but for the cost limit, 25 as on its other
    tasks; presets set it for Circle2D.
    """

    batch_size: Annotated[int, In(1)] = 256
    """Steps in a minibatch of the critics; a multiple of 32. Paper: 256."""
    target_kl: Annotated[float, In(1e-8, 10)] = 0.01
    """Largest mean KL divergence δ of a step of the policy. Paper: 0.01."""
    cg_iterations: Annotated[int, In(1, 10_000)] = 15
    """Iterations of conjugate gradients. Paper: 15."""
    cg_damping: Annotated[float, In(0, 1e6)] = 0.1
    """Added to the diagonal of the KL divergence's Hessian. Not printed in the paper; 0.1 as in
    Stable-Baselines3."""
    line_search_steps: Annotated[int, In(1, 10_000)] = 15
    """Lengths of a step that are tried at most. Paper: 15."""
    line_search_decay: Annotated[float, In(above=0, high=1)] = 0.8
    """Factor between the lengths tried, in (0, 1]. Not printed in the paper; 0.8 as in
    Stable-Baselines3."""


class StepRule(NamedTuple):
    """How an algorithm of the family treats costs. Every function takes its config first."""

    advantage: Callable[[Any, Tensor, Tensor, Tensor], Tensor]
    """(config, reward advantages [R, B], cost advantages [R, C, B], multipliers [R, M]) -> [R, B]:
    the advantages that the policy's step raises."""
    step: Callable[[Any, Problem], Step]
    """(config, problem) -> the step that is tried."""
    multipliers: tuple[Multiplier, ...] = ()
    """Each follows `J_C - d` of its cost."""
    has_cases: bool = False
    """Whether `Step.case` is worth recording."""
    costs: int = 1
    """How many costs are learned."""


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
def gradient_in(nets: Nets, actor: Tensor, block: Block, of: int) -> Tensor:
    """A block's part of the gradient of `compared`'s surrogate `of`, [R, actor size]."""
    return torch.func.grad(lambda params: compared_in(nets, params, block)[0][:, of].sum())(actor)


def policy_step(
    nets: Nets, config: Any, rule: StepRule, state: OnPolicyState, epoch: Epoch
) -> tuple[Tensor, dict[str, Tensor]]:
    """The policy after the rule's step and its line search -> [R, actor size], records [R]."""
    old = state.actor
    multipliers = lagrange.values(rule.multipliers, state.multipliers, len(old))
    advantage = rule.advantage(config, epoch.reward_advantage, epoch.cost_advantage, multipliers)
    steps = blocks_of(nets, old, epoch, advantage)

    def gradient(of: int) -> Tensor:
        return sum(
            (gradient_in(nets, old, block, of) for block in steps), start=torch.zeros_like(old)
        )

    product = fisher_product(nets, old, steps, config.cg_damping)
    problem = Problem(
        gradient=gradient(0),
        cost_gradient=lambda: gradient(1) * epoch.length[:, None],
        excess=(epoch.cost[:, 0] - config.cost_limit).to(old.dtype),
        product=product,
        solve=lambda b: conjugate_gradient(product, b, config.cg_iterations),
        target_kl=config.target_kl,
        multipliers=multipliers,
    )
    step = rule.step(config, problem)
    before, _ = compared(nets, old, steps)

    def judge(actor: Tensor) -> tuple[Tensor, Tensor]:
        after, kl = compared(nets, actor, steps)
        growth, cost_growth = (after - before).unbind(dim=-1)
        cost_growth = cost_growth * epoch.length
        near = step.divergence(kl, cost_growth) <= config.target_kl
        allowed = near & ((growth > 0) | ~step.must_improve) & (cost_growth <= step.cost_bound)
        return allowed | (epoch.length == 0), kl  # a run that takes no part accepts at once

    tries, decay = config.line_search_steps, config.line_search_decay
    found = line_search(old, step.displacement, judge, tries, decay)
    records = {"kl": found.kl, "step_scale": found.scale, "case": step.case.float()}
    names = lagrange.names(rule.multipliers)
    return found.params, records | dict(zip(names, multipliers.unbind(dim=-1), strict=True))
