"""CPO: constrained policy optimisation.

Source: Achiam et al. 2017, "Constrained policy optimization", section 6 and appendix 10.2; in the
paper's grid as "CPO".
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from agents.updates.trpo import StepRule, TRPOConfig
from agents.updates.trust_region import Problem, Step, dot

INSIDE, PARTLY, RECOVERABLE, RECOVERY = 1, 2, 3, 4
"""The cases of the step: the trust region lies wholly on the allowed side (or costs do not depend
on the policy); the limit is kept and cuts the trust region; it is broken and the trust region
reaches back; it is broken and the trust region does not."""


@dataclass(frozen=True)
class CPOConfig(TRPOConfig):
    """Hyper-parameters of CPO."""


def objective(
    config: CPOConfig, reward_advantage: Tensor, cost_advantage: Tensor, multiplier: Tensor
) -> Tensor:
    """`A_r`: costs come in as a constraint."""
    return reward_advantage


def step(config: CPOConfig, problem: Problem) -> Step:
    """The solution of `max g·x` subject to `c + b·x ≤ 0` and `½ xᵀHx ≤ δ`.

    Recovery, where there is none: down the cost to the boundary of the trust region. The line
    search lets the predicted cost come up to the limit, or not grow where it is above, and asks for
    a better objective only where the limit is kept.
    """
    excess = problem.excess[:, None]
    natural = problem.solve(problem.gradient)
    b = problem.cost_gradient()
    natural_b = problem.solve(b)
    s = dot(b, natural_b)
    # Half the squared distance, in KL, of the limit's plane less that of the region's boundary
    room = 2.0 * config.target_kl - excess**2 / s.clamp(min=1e-12)
    vanishing = s < 1e-8
    kept = torch.where(vanishing | (room < 0), INSIDE, PARTLY)
    broken = torch.where(vanishing, INSIDE, torch.where(room < 0, RECOVERY, RECOVERABLE))
    case = torch.where(excess <= 0, kept, broken)
    along = problem.to_boundary(torch.where(case == RECOVERY, -natural_b, natural))
    by_dual = dual_step(problem, natural, natural_b, b)
    return Step(
        step=torch.where((case == PARTLY) | (case == RECOVERABLE), by_dual, along),
        must_improve=(case <= PARTLY)[:, 0],
        cost_bound=(-problem.excess).clamp(min=0.0),
        case=case[:, 0],
    )


def dual_step(problem: Problem, natural: Tensor, natural_b: Tensor, b: Tensor) -> Tensor:
    """`x = H⁻¹(g - ν b) / λ` with the multipliers of trust region and cost from the dual, [R, P].

    With `q = gᵀH⁻¹g`, `r = gᵀH⁻¹b`, `s = bᵀH⁻¹b` the dual function of λ has a branch for `ν > 0`,
    `-½ ((q - r²/s)/λ + (2δ - c²/s) λ) + r c/s`, and one for `ν = 0`, `-½ (q/λ + 2δ λ)`; they meet
    at `λ c + r = 0`. Each is maximised on its own interval, and the better one is taken.
    """
    tiny = 1e-12
    c, delta = problem.excess[:, None].double(), problem.target_kl
    q, r, s = (
        dot(*pair).double()
        for pair in ((problem.gradient, natural), (problem.gradient, natural_b), (b, natural_b))
    )
    s = s.clamp(min=tiny)
    c = torch.where(c.abs() < tiny, -tiny, c)
    a_reward, a_room = (q - r * r / s).clamp(min=0.0), (2.0 * delta - c * c / s).clamp(min=tiny)
    meeting = (-r / c).clamp(min=tiny)
    nothing, everything = torch.full_like(c, tiny), torch.full_like(c, torch.inf)
    # λ c + r > 0 holds below the meeting point where c < 0, above it where c > 0.
    bound = (torch.where(c < 0, nothing, meeting), torch.where(c < 0, meeting, everything))
    free = (torch.where(c < 0, meeting, nothing), torch.where(c < 0, everything, meeting))
    lambda_bound = (a_reward / a_room).sqrt().clamp(*bound)
    lambda_free = (q / (2.0 * delta)).sqrt().clamp(*free)
    dual_bound = -0.5 * (a_reward / lambda_bound + a_room * lambda_bound) + r * c / s
    dual_free = -0.5 * (q / lambda_free + 2.0 * delta * lambda_free)
    multiplier = torch.where(dual_bound >= dual_free, lambda_bound, lambda_free)
    nu = (multiplier * c + r).clamp(min=0.0) / s
    return ((natural - nu.float() * natural_b) / multiplier.float()).float()


RULE = StepRule(objective, step, metrics=("case",))
