"""C-TRPO: a trust region of only safe policies: its divergence grows towards the cost limit.

Source: Milosevic, Müller & Scherf 2025, "Embedding safety into RL: a new take on trust region
methods", algorithm 1, and the authors' code.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import torch
from torch import Tensor

from agents.algorithms import Algorithm, trpo_lag
from agents.algorithms.crpo import advantage  # for the reward, or in recovery against the cost
from agents.checks import In
from agents.errors import UserError
from agents.lockstep.lagrange import PROJECTED, Multiplier
from agents.trust_region import (
    Problem,
    Step,
    StepRule,
    TRPOConfig,
    TrustRegion,
    conjugate_gradient,
    dot,
)


@dataclass(frozen=True)
class CTRPOConfig(TRPOConfig):
    """Hyper-parameters of C-TRPO. The recorded multiplier is 1 in epochs of recovery."""

    barrier: Annotated[float, In(0, 1e6)] = 1.0
    """Factor β of the cost's term in the divergence. Milosevic et al.: 1."""
    hysteresis: Annotated[float, In(0, 1)] = 0.8
    """Share of the limit below which the cost must fall before recovery ends. Milosevic et al.:
    0.8."""

    def __post_init__(self) -> None:
        """Check the values. Raises UserError naming one that is not allowed."""
        super().__post_init__()
        if self.cost_limit == 0:
            raise UserError("cost_limit must be above 0 with C-TRPO: at a limit of 0 it recovers")


def recovers(config: CTRPOConfig, before: Tensor, cost: Tensor) -> Tensor:
    """Return 1 where `J_C ≥ d`, in recovery where `J_C ≥ hysteresis · d`, else 0; cost: [R, 1]."""
    bound = config.cost_limit * torch.where(before > 0, config.hysteresis, 1.0)
    return (cost >= bound).to(before.dtype)


def step(config: CTRPOConfig, problem: Problem) -> Step:
    """TRPO's step under the divergence `KL + β φ(α)`, `φ(α) = α + (Δ - α) log(1 - α/Δ)`.

    α is the predicted growth of the cost, Δ = d - J_C its distance to the limit; the Hessian of the
    divergence is `H + β/Δ b bᵀ`. In recovery it is TRPO's step against the cost.
    """
    room = -problem.excess
    safe = (problem.multipliers[:, 0] == 0) & (room > 0)
    b, room = problem.cost_gradient(), torch.where(safe, room, 1.0)
    weight = torch.where(safe, config.barrier, 0.0)

    def product(v: Tensor) -> Tensor:
        return problem.product(v) + (weight / room)[:, None] * dot(b, v) * b

    def divergence(kl: Tensor, growth: Tensor) -> Tensor:
        left = 1.0 - growth / room
        phi = growth + room * left * left.clamp(min=1e-30).log()
        return kl + torch.where(left > 0, weight * phi, torch.where(safe, torch.inf, 0.0))

    inner = problem._replace(
        product=product, solve=lambda v: conjugate_gradient(product, v, config.cg_iterations)
    )
    return trpo_lag.step(config, inner)._replace(divergence=divergence)


SWITCH = Multiplier(PROJECTED._replace(law=recovers), ahead=True)
RULE = StepRule(advantage, step, (SWITCH,))
ALGORITHM = Algorithm("C-TRPO", CTRPOConfig, RULE, TrustRegion, work=1.3)
