"""The trust-region family: natural-gradient steps of the policy with a line search.

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

    The defaults are the paper's (table HP_Circle2D), except for the cost limit of 25, which is that
    of the paper's other tasks; presets set the limit for Circle2D.
    """

    batch_size: Annotated[int, In(1)] = 256
    """Environment steps in a minibatch of the critics. Paper: 256."""
    target_kl: Annotated[float, In(1e-8, 10)] = 0.01
    """Largest mean KL divergence δ of a step of the policy. Paper: 0.01."""
    cg_iterations: Annotated[int, In(1, 10_000)] = 15
    """Iterations of the conjugate gradient method. Paper: 15."""
    cg_damping: Annotated[float, In(0, 1e6)] = 0.1
    """Damping, added to the diagonal of the KL divergence's Hessian. Not specified in the paper;
    0.1 as in Stable-Baselines3."""
    line_search_steps: Annotated[int, In(1, 10_000)] = 15
    """Largest number of step lengths that the line search tries. Paper: 15."""
    line_search_decay: Annotated[float, In(above=0, high=1)] = 0.8
    """Factor between successive step lengths, in (0, 1]. Not specified in the paper; 0.8 as in
    Stable-Baselines3."""


class StepRule(NamedTuple):
    """How an algorithm of the family treats costs. Every function takes its config first."""

    advantage: Callable[[Any, Tensor, Tensor, Tensor], Tensor]
    """(config, reward advantages [R, B], cost advantages [R, C, B], multipliers [R, M]) -> [R, B]:
    the advantages that the policy's step raises. Called for one run at a time, with the environment
    steps of its epoch."""
    step: Callable[[Any, Problem], Step]
    """(config, problem) -> the step that the line search tries."""
    multipliers: tuple[Multiplier, ...] = ()
    """Each follows `J_C - d` of its cost."""
    has_cases: bool = False
    """Whether `Step.case` is worth recording."""
    costs: int = 1
    """How many costs are learned; the step and the line search see only the first."""
    limits: tuple[str, ...] = ("cost_limit",)
    """Names of the hyper-parameters that limit the costs, in the order of the costs; the `limit` of
    a multiplier takes precedence for its cost."""


def curvature(nets: Nets, config: Any, actor: Tensor, epoch: EpochData) -> tuple[Product, Product]:
    """Return the functions v -> H v and b -> H⁻¹ b, all [R, actor size], for the damped Hessian H
    of the mean KL divergence at the current policy."""
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
    """Take the rule's step with its line search -> new parameters [R, actor size], records [R]; the
    parameters of a run whose step is NaN become NaN. steps: [R], environment steps of each run."""
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
        excess=of_cost(epoch.cost - tensor(lagrange.limits(rule, config))).to(old.dtype),
        product=product,
        solve=solve,
        target_kl=config.target_kl,
        multipliers=multipliers,
    )
    step = rule.step(config, problem)
    before, _ = compared(nets, old, taken_steps)

    def judge(actor: Tensor) -> tuple[Tensor, Tensor]:
        after, kl = compared(nets, actor, taken_steps)
        growth, cost_growth = (after - before)[:, 0], of_cost((after - before)[:, 1:])
        cost_growth = cost_growth * epoch.length
        near = step.divergence(kl, cost_growth) <= config.target_kl
        allowed = near & ((growth > 0) | ~step.must_improve) & (cost_growth <= step.cost_bound)
        return allowed | (epoch.length == 0), kl  # an inactive run accepts at once

    tries, decay = config.line_search_steps, config.line_search_decay
    found = line_search(old, step.displacement, judge, tries, decay)
    # The line search would accept no such step, and the policy silently stay as it is.
    lost = advantage.isnan().any(dim=-1) | step.displacement.isnan().any(dim=-1)
    params = torch.where(lost[:, None], torch.nan, found.params)
    records = {"kl": found.kl, "step_scale": found.scale, "case": step.case.float()}
    names = lagrange.names(rule.multipliers)
    return params, records | dict(zip(names, multipliers.unbind(dim=-1), strict=True))


def of_cost(columns: Tensor) -> Tensor:
    """Return the first learned cost's column of [R, C], or zeros if no cost is learned."""
    return columns[:, :1].sum(dim=-1)


def dot(a: Tensor, b: Tensor) -> Tensor:
    """Return the inner products of the runs' vectors, [R, P] -> [R, 1]."""
    return (a * b).sum(dim=-1, keepdim=True)


def conjugate_gradient(product: Product, b: Tensor, iterations: int) -> Tensor:
    """Solve `product(x) = b` for x: `kernel.conjugate_gradient` on tensors."""

    def in_numpy(v: NDArray) -> NDArray:
        return product(torch.from_numpy(v)).numpy()

    return torch.from_numpy(kernel.conjugate_gradient(in_numpy, b.numpy(), iterations))


class Problem(NamedTuple):
    """The local model of each run from which a step of its policy is computed."""

    gradient: Tensor
    """[R, P]: of the objective"""
    cost_gradient: Callable[[], Tensor]
    """() -> [R, P]: of the undiscounted cost of an episode"""
    excess: Tensor
    """[R]: by how much an episode's cost exceeds the limit, `J_C - d`; 0 if no cost is learned"""
    product: Product
    """v -> H v, H the damped Hessian of the mean KL divergence"""
    solve: Product
    """b -> H⁻¹ b"""
    target_kl: float
    """δ"""
    multipliers: Tensor = torch.zeros(0)
    """[R, M]"""

    def to_boundary(self, direction: Tensor) -> Tensor:
        """Scale a direction [R, P] such that `½ xᵀ H x = δ`; 0 stays 0."""
        square = dot(direction, self.product(direction))
        return direction * torch.where(square > 0, (2.0 * self.target_kl / square).sqrt(), 0.0)


Divergence = Callable[[Tensor, Tensor], Tensor]
"""(mean KL divergence [R], growth of the predicted cost of an episode [R]) -> [R]"""


class Step(NamedTuple):
    """A step for the line search to try, and the conditions for accepting it."""

    displacement: Tensor
    """[R, P]"""
    must_improve: Tensor
    """[R], bool: whether the objective has to grow"""
    cost_bound: Tensor
    """[R]: largest growth allowed of the predicted cost of an episode; inf for no bound"""
    case: Tensor
    """[R]: number of the algorithm's case that the step belongs to, for the records"""
    divergence: Divergence = lambda kl, cost_growth: kl
    """Divergence that the line search keeps at or below δ."""


class Accepted(NamedTuple):
    """The result of a line search."""

    params: Tensor
    """[R, P]"""
    accepted: Tensor
    """[R], bool; the others keep their parameters"""
    kl: Tensor
    """[R]: KL divergence of the returned parameters"""
    scale: Tensor
    """[R]: factor of the displacement that was accepted; 0: none"""


Judge = Callable[[Tensor], tuple[Tensor, Tensor]]
"""params [R, P] -> whether they are acceptable [R], bool, and their KL divergence [R]"""


def line_search(
    params: Tensor, displacement: Tensor, judge: Judge, tries: int, decay: float
) -> Accepted:
    """Backtrack: find each run's first accepted `params + decay^k displacement`, k < tries.

    params, displacement: [R, P]. A run for which `judge` accepts none keeps its parameters, bit for
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
    """step_scale is 0 where the line search accepted no step and the policy stayed as it was."""

    def __init__(self, config: TRPOConfig, rule: StepRule, *runs: Any) -> None:
        super().__init__(config, rule, *runs)
        self.metrics += ("case",) * rule.has_cases

    def improve(
        self, epoch: EpochData, steps: NDArray[np.int64], generators: list[np.random.Generator]
    ) -> tuple[OnPolicyState, dict[str, Tensor]]:
        """Take one step of the policy from the whole epoch."""
        actor, records = policy_step(self.nets, self.config, self.rule, self._state, epoch, steps)
        return self._state._replace(actor=actor), records
