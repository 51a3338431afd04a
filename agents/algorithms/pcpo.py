"""PCPO: projection-based constrained policy optimisation.

Source: Yang et al. 2020, "Projection-based constrained policy optimization", algorithm 1 and
equation 4.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import torch

from agents.algorithms import Algorithm
from agents.algorithms.ppo import advantage  # of reward alone: costs enter in the projection
from agents.checks import In
from agents.trust_region import Problem, Step, StepRule, TRPOConfig, TrustRegion, dot


@dataclass(frozen=True)
class PCPOConfig(TRPOConfig):
    """Hyper-parameters of PCPO."""

    projection: Literal["kl", "l2"] = "kl"
    """Distance from the reward's step that the projection minimises: the KL divergence of the
    policies (kl), or the Euclidean distance of their parameters (l2). Yang et al. have both."""
    line_search_steps: Annotated[int, In(1, 10_000)] = 200
    """Largest number of step lengths that the line search tries; a projection may be far longer
    than the trust region. 200 as in OmniSafe."""


def step(config: PCPOConfig, problem: Problem) -> Step:
    """`x = r - max(0, (b·r + c) / b·L⁻¹b) L⁻¹b`: TRPO's step r, projected onto the half-space
    `c + b·x ≤ 0` in the norm of L, which is H or the identity.

    The line search lets the predicted cost rise up to the limit, or not at all where the cost
    exceeds it.
    """
    rewarding = problem.to_boundary(problem.solve(problem.gradient))
    b, c = problem.cost_gradient(), problem.excess[:, None]
    back = problem.solve(b) if config.projection == "kl" else b
    s = dot(b, back)
    beyond = ((c + dot(b, rewarding)) / s.clamp(min=1e-12)).clamp(min=0.0)
    return Step(
        displacement=rewarding - torch.where(s > 1e-8, beyond, 0.0) * back,
        must_improve=torch.zeros_like(problem.excess, dtype=torch.bool),
        cost_bound=(-problem.excess).clamp(min=0.0),
        case=torch.where(beyond[:, 0] > 0, 2, 1),
    )


RULE = StepRule(advantage, step, has_cases=True)
ALGORITHM = Algorithm("PCPO", PCPOConfig, RULE, TrustRegion, work=1.3)
