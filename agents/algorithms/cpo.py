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
"""The cases of the step: the trust region lies wholly on the allowed side (or costs do not depend
on the policy); the limit is kept and cuts the trust region; it is broken and the trust region
reaches back; it is broken and the trust region does not."""


@dataclass(frozen=True)
class CPOConfig(TRPOConfig):
    """Hyper-parameters of CPO."""


def step(config: CPOConfig, problem: Problem) -> Step:
    """The solution of `max g·x` subject to `c + b·x ≤ 0` and `½ xᵀHx ≤ δ`.

    Recovery, where there is none: down the cost to the boundary of the trust region. The line
    search lets the predicted cost come up to the limit, or not grow where it is above, and asks for
    a better objective only where the limit is kept.
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
    """The best step with `c + b·x = 0` within the trust region, [R, P].

    The shortest way to that plane, `-c/s H⁻¹b`, and from there along the natural gradient within
    the plane as far as the trust region goes. It is the `H⁻¹(g - ν b)/λ` of the dual's branch with
    ν > 0, without the differences of multipliers that rounding spoils where g is nearly along b.
    """
    c, s = problem.excess[:, None], s.clamp(min=1e-12)
    across = natural
    for _ in range(2):  # again, for what the first leaves of b in float32
        across = across - dot(b, across) / s * natural_b
    # Where reward and cost have one gradient, only rounding is left of g: no direction.
    gain = dot(problem.gradient, across)
    across = torch.where(gain > 1e-6 * dot(problem.gradient, natural), across, 0.0)
    room = (1.0 - c**2 / (2.0 * problem.target_kl * s)).clamp(min=0.0).sqrt()
    return room * problem.to_boundary(across) - c / s * natural_b


RULE = StepRule(advantage, step, has_cases=True)
ALGORITHM = Algorithm("CPO", CPOConfig, RULE, TrustRegion, work=1.3)
