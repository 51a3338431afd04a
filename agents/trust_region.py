"""The trust-region step of the policy: natural gradient and line search.

An algorithm adds a `StepRule`. Source: Schulman et al. 2015, "Trust region policy
optimization", with the cost terms of the algorithm's paper.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from agents.checks import In
from agents.lockstep import kernel, lagrange
from agents.lockstep.backend import tensor
from agents.lockstep.lagrange import Multiplier
from agents.on_policy.epoch import (
    EpochData,
    compared,
    raised_advantage,
    taken,
)
from agents.on_policy.learner import OnPolicy
from agents.on_policy.state import EpisodeCostLimit, Nets, OnPolicyConfig, OnPolicyState

Product = Callable[[Tensor], Tensor]


@dataclass(frozen=True)
class TRPOConfig(EpisodeCostLimit, OnPolicyConfig):
    """Hyper-parameters of the trust-region family.

    The defaults are the paper's (table HP_Circle2D) but for the cost limit, 25 as on its other
    tasks; presets set it for Circle2D.
    """

    batch_size: Annotated[int, In(1)] = 256
    """Steps in a minibatch of the critics. Paper: 256."""
    target_kl: Annotated[float, In(1e-8, 10)] = 0.01
    """Largest mean KL divergence δ of a step of the policy. Paper: 0.01."""
    cg_iterations: Annotated[int, In(1, 10_000)] = 15
    """Iterations of conjugate gradients. Paper: 15."""
    cg_damping: Annotated[float, In(0, 1e6)] = 0.1
    """Added to the diagonal of the KL divergence's Hessian. Not specified in the paper; 0.1 as in
    Stable-Baselines3."""
    line_search_steps: Annotated[int, In(1, 10_000)] = 15
    """Lengths of a step that are tried at most. Paper: 15."""
    line_search_decay: Annotated[float, In(above=0, high=1)] = 0.8
    """Factor between the lengths tried, in (0, 1]. Not specified in the paper; 0.8 as in
    Stable-Baselines3."""


class StepRule(NamedTuple):
    """How an algorithm of the family treats costs. Every function takes its config first."""

    advantage: Callable[[Any, Tensor, Tensor, Tensor], Tensor]
    """(config, reward advantages [R, B], cost advantages [R, C, B], multipliers [R, M]) -> [R, B]:
    the advantages that the policy's step raises. Called for one run at a time, with the steps of
    its epoch."""
    step: Callable[[Any, Problem], Step]
    """(config, problem) -> the step that is tried."""
    multipliers: tuple[Multiplier, ...] = ()
    """Each follows `J_C - d` of its cost."""
    has_cases: bool = False
    """Whether `Step.case` is worth recording."""
    costs: int = 1
    """How many costs are learned; the step and its line search see the first alone."""
    limits: tuple[str, ...] = ("cost_limit",)
    """Names of the hyper-parameters that limit the costs, in their order; a multiplier names that
    of its cost itself."""


def curvature(nets: Nets, config: Any, actor: Tensor, epoch: EpochData) -> tuple[Product, Product]:
    """v -> H v and b -> H⁻¹ b, all [R, actor size], of the damped Hessian H of the mean KL
    divergence at the policy itself."""
    columns = actor.numpy(), nets.actor.log_std, epoch.observation.numpy(), epoch.weight.numpy()
    it = kernel.Curvature(nets.actor.net, *columns, config.cg_damping)
    own = kernel.of(it.params)

    def of(iterations: int) -> Product:
        return lambda v: torch.from_numpy(own.curvature(it, v.numpy(), iterations))

    return of(0), of(config.cg_iterations)


def policy_step(
    nets: Nets,
    config: Any,
    rule: StepRule,
    state: OnPolicyState,
    epoch: EpochData,
    steps: NDArray[np.int64],
) -> tuple[Tensor, dict[str, Tensor]]:
    """The policy after the rule's step and its line search -> [R, actor size], records [R]; NaN for
    a run whose step is. steps: [R], of each run in the epoch."""
    old = state.actor
    multipliers = tensor(lagrange.values(rule.multipliers, state.multipliers, len(old)))
    advantage = raised_advantage(rule, config, epoch, steps, multipliers)
    taken_steps = taken(nets, old, epoch, advantage)

    def gradient(of: int) -> Tensor:
        with torch.enable_grad():
            at = old.detach().requires_grad_()
            return torch.autograd.grad(compared(nets, at, taken_steps)[0][:, of].sum(), at)[0]

    product, solve = curvature(nets, config, old, epoch)
    problem = Problem(
        gradient=gradient(0),
        cost_gradient=lambda: gradient(1) * epoch.length[:, None],
        excess=(epoch.cost - tensor(lagrange.limits(rule, config)))[:, 0].to(old.dtype),
        product=product,
        solve=solve,
        target_kl=config.target_kl,
        multipliers=multipliers,
    )
    step = rule.step(config, problem)
    before, _ = compared(nets, old, taken_steps)

    def judge(actor: Tensor) -> tuple[Tensor, Tensor]:
        after, kl = compared(nets, actor, taken_steps)
        growth, cost_growth = (after - before).unbind(dim=-1)
        cost_growth = cost_growth * epoch.length
        near = step.divergence(kl, cost_growth) <= config.target_kl
        allowed = near & ((growth > 0) | ~step.must_improve) & (cost_growth <= step.cost_bound)
        return allowed | (epoch.length == 0), kl  # a run that takes no part accepts at once

    tries, decay = config.line_search_steps, config.line_search_decay
    found = line_search(old, step.displacement, judge, tries, decay)
    # No step leads there, and the policy would stay as it is without a word.
    lost = advantage.isnan().any(dim=-1) | step.displacement.isnan().any(dim=-1)
    params = torch.where(lost[:, None], torch.nan, found.params)
    records = {"kl": found.kl, "step_scale": found.scale, "case": step.case.float()}
    names = lagrange.names(rule.multipliers)
    return params, records | dict(zip(names, multipliers.unbind(dim=-1), strict=True))


def dot(a: Tensor, b: Tensor) -> Tensor:
    """Inner product of each run's vectors [R, P] -> [R, 1]."""
    return (a * b).sum(dim=-1, keepdim=True)


def conjugate_gradient(product: Product, b: Tensor, iterations: int) -> Tensor:
    """Solve `product(x) = b` for x: `kernel.conjugate_gradient` on tensors."""

    def in_numpy(v: NDArray) -> NDArray:
        return product(torch.from_numpy(v)).numpy()

    return torch.from_numpy(kernel.conjugate_gradient(in_numpy, b.numpy(), iterations))


class Problem(NamedTuple):
    """The local model that a step of the policy is computed from; each run's own."""

    gradient: Tensor
    """[R, P]: of the objective"""
    cost_gradient: Callable[[], Tensor]
    """() -> [R, P]: of the undiscounted cost of an episode"""
    excess: Tensor
    """[R]: cost of an episode above its limit, `J_C - d`"""
    product: Product
    """v -> H v, H the damped Hessian of the mean KL divergence"""
    solve: Product
    """b -> H⁻¹ b"""
    target_kl: float
    """δ"""
    multipliers: Tensor = torch.zeros(0)
    """[R, M]"""

    def to_boundary(self, direction: Tensor) -> Tensor:
        """The direction [R, P] scaled until `½ xᵀ H x = δ`; 0 stays 0."""
        square = dot(direction, self.product(direction))
        return direction * torch.where(square > 0, (2.0 * self.target_kl / square).sqrt(), 0.0)


Divergence = Callable[[Tensor, Tensor], Tensor]
"""(mean KL divergence [R], growth of the predicted cost of an episode [R]) -> [R]"""


class Step(NamedTuple):
    """A step to be tried, and the conditions of its line search."""

    displacement: Tensor
    """[R, P]"""
    must_improve: Tensor
    """[R], bool: whether the objective has to grow"""
    cost_bound: Tensor
    """[R]: how much the predicted cost of an episode may grow; inf where it does not matter"""
    case: Tensor
    """[R]: which case of the algorithm the step is, for the records"""
    divergence: Divergence = lambda kl, cost_growth: kl
    """Divergence that the line search keeps at or below δ."""


class Accepted(NamedTuple):
    """The result of a line search."""

    params: Tensor
    """[R, P]"""
    accepted: Tensor
    """[R], bool; the others keep their parameters"""
    kl: Tensor
    """[R]: of the parameters kept"""
    scale: Tensor
    """[R]: share of the step that was taken"""


Judge = Callable[[Tensor], tuple[Tensor, Tensor]]
"""params [R, P] -> which runs may go there [R], bool, and their KL divergence [R]"""


def line_search(
    params: Tensor, displacement: Tensor, judge: Judge, tries: int, decay: float
) -> Accepted:
    """The first of `params + decay^k displacement`, k < tries, that each run's judge accepts.

    params, displacement: [R, P]. Where none is accepted the parameters stay as they are, bit for
    bit.
    """
    none = torch.zeros(len(params))
    found = Accepted(params, none.bool(), none, none)
    for k in range(tries):
        candidate = params + decay**k * displacement
        allowed, kl = judge(candidate)
        new = allowed & ~found.accepted & candidate.isfinite().all(dim=-1)
        found = Accepted(
            torch.where(new[:, None], candidate, found.params),
            found.accepted | new,
            torch.where(new, kl, found.kl),
            torch.where(new, decay**k, found.scale),
        )
        if found.accepted.all():
            break
    return found


class TrustRegion(OnPolicy):
    """The runs of one algorithm of the trust-region family."""

    takes = (TRPOConfig, StepRule)
    improvement_metrics = ("kl", "step_scale")
    """A step_scale of 0: the line search found nothing, and the policy stayed as it was."""

    def __init__(self, config: TRPOConfig, rule: StepRule, *runs: Any) -> None:
        super().__init__(config, rule, *runs)
        self.metrics += ("case",) * rule.has_cases

    def improve(
        self, epoch: EpochData, steps: NDArray[np.int64], generators: list[np.random.Generator]
    ) -> tuple[OnPolicyState, dict[str, Tensor]]:
        """One step of the policy, from all of the epoch at once."""
        actor, records = policy_step(self.nets, self.config, self.rule, self._state, epoch, steps)
        return self._state._replace(actor=actor), records
