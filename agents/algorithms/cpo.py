"""CPO: constrained policy optimisation.

Source: Achiam et al. 2017, "Constrained policy optimization", section 6 and appendix 10.2; in the
paper's grid as "CPO".
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from agents.algorithms import Algorithm
from agents.algorithms.ppo import advantage  # of reward alone: costs enter as a constraint
from agents.trust_region import Problem, Step, StepRule, TRPOConfig, TrustRegion, dot

INSIDE, PARTLY, RECOVERABLE, RECOVERY = 1, 2, 3, 4
"""Cases of the step. INSIDE: the whole trust region satisfies the constraint, or the cost does not
depend on the policy. PARTLY: the policy satisfies the constraint, but not the whole trust region.
RECOVERABLE: the policy violates it, but not the whole trust region. RECOVERY: the whole trust
region violates it."""


@dataclass(frozen=True)
class CPOConfig(TRPOConfig):
    """Hyper-parameters of CPO."""


def step(config: CPOConfig, problem: Problem) -> Step:
    """Solve `max g·x` subject to `c + b·x ≤ 0` and `½ xᵀHx ≤ δ`.

    Where there is no solution, the step goes down the cost to the boundary of the trust region:
    recovery. The line search lets the predicted cost rise up to the limit, or not at all where the
    cost exceeds it, and asks for a better objective only of runs that satisfy the constraint.
    """
    c = problem.excess[:, None]
    natural = problem.solve(problem.gradient)
    b = problem.cost_gradient()
    natural_b = problem.solve(b)
    s = dot(b, natural_b)
    vanishing = s < 1e-8
    reaches = c**2 <= 2.0 * config.target_kl * s  # the limit's plane cuts the trust region
    kept = torch.where(vanishing | ~reaches, INSIDE, PARTLY)
    broken = torch.where(vanishing, INSIDE, torch.where(reaches, RECOVERABLE, RECOVERY))
    case = torch.where(c <= 0, kept, broken)
    plain = problem.to_boundary(torch.where(case == RECOVERY, -natural_b, natural))
    cut = ((case == PARTLY) | (case == RECOVERABLE)) & (c + dot(b, plain) > 0)
    return Step(
        displacement=torch.where(cut, on_limit(problem, natural, natural_b, b, s), plain),
        must_improve=problem.excess <= 0,
        cost_bound=(-problem.excess).clamp(min=0.0),
        case=case[:, 0],
    )


def on_limit(problem: Problem, natural: Tensor, natural_b: Tensor, b: Tensor, s: Tensor) -> Tensor:
    """Return the best step with `c + b·x = 0` within the trust region, [R, P].

    It goes the shortest way to that plane, `-c/s H⁻¹b`, and from there along the natural gradient
    within the plane to the boundary of the trust region. This is `H⁻¹(g - ν b)/λ`, the solution of
    the dual problem where ν > 0, without its differences of multipliers, in which rounding errors
    dominate where g is nearly parallel to b.
    """
    c, s = problem.excess[:, None], s.clamp(min=1e-12)
    across = natural
    for _ in range(2):  # in float32 the first projection leaves a part along b
        across = across - dot(b, across) / s * natural_b
    # Where the gradients of reward and cost are parallel, only rounding errors are left of g.
    gain = dot(problem.gradient, across)
    across = torch.where(gain > 1e-6 * dot(problem.gradient, natural), across, 0.0)
    room = (1.0 - c**2 / (2.0 * problem.target_kl * s)).clamp(min=0.0).sqrt()
    return room * problem.to_boundary(across) - c / s * natural_b


RULE = StepRule(advantage, step, has_cases=True)
ALGORITHM = Algorithm("CPO", CPOConfig, RULE, TrustRegion, work=1.3)
