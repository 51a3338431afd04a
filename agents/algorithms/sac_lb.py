"""SAC-LB: soft actor-critic with a log barrier instead of a Lagrange multiplier.

Source: Zhang et al. 2024, "Constrained reinforcement learning with smoothed log barrier function"
(CSAC-LB); in the paper's grid as "SAC-LB".
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from agents.algorithms import Algorithm
from agents.algorithms.sac_lag import critic_loss, risk
from agents.checks import In
from agents.lockstep.backend import tensor
from agents.lockstep.kernel import Float
from agents.lockstep.pulled import Pull, closed_form
from agents.lockstep.streaks import StreakLimit
from agents.sac import ConstrainedSACConfig, CostRule, OffPolicy


@dataclass(frozen=True)
class SACLBConfig(StreakLimit, ConstrainedSACConfig):
    """Hyper-parameters of SAC-LB."""

    log_barrier_factor: Annotated[float, In(1e-3, 1e3)] = 3.0
    """Factor t of the barrier: the larger it is, the closer to a hard constraint. Paper: 3 (printed
    in SAC-Lag's column of table HP_Circle2D, but it can only be SAC-LB's)."""
    streak_limit: Annotated[float, In(0, 1e9)] | None = None
    """Limit, in steps, of the discounted `record_cost` return that its critics estimate: by how
    much the longest streak of an episode will still grow. It is a second cost, with a barrier of
    its own; policy and critics then see the current streak and the longest streak so far, both
    divided by 20. Not in the paper; None: none."""

    @property
    def limits(self) -> NDArray[np.float64]:
        """The limit of each cost, [C, 1]."""
        streaks = [] if self.streak_limit is None else [self.streak_limit]
        return np.array([self.cost_limit, *streaks])[:, None]


def log_barrier(z: Tensor, t: float) -> Tensor:
    """`ψ(z) = -log(-z) / t` for `z ≤ -1/t²`, and its tangent there for larger z.

    z: by how much the cost exceeds its limit. The tangent, `t z - log(1/t²)/t + 1/t`, is defined
    also where the constraint is violated.
    """
    switch = -1.0 / t**2
    # The clamp keeps both branches finite, so that no gradient is 0 · inf.
    barrier = -torch.log(-z.clamp(max=switch)) / t
    tangent = t * z - math.log(-switch) / t + 1.0 / t
    return torch.where(z <= switch, barrier, tangent)


def penalty(config: SACLBConfig, risk: Tensor, multipliers: Tensor) -> Tensor:
    """`ψ(max Q_c - d)` of each cost."""
    return log_barrier(risk - tensor(config.limits).to(risk.dtype), config.log_barrier_factor)


@closed_form(penalty)
def _penalty(config: SACLBConfig, risk: Float, multipliers: Float) -> tuple[Float, Pull]:
    z, t = risk - config.limits.astype(risk.dtype), config.log_barrier_factor
    switch = -1.0 / t**2
    inside, tangent = z.clip(max=switch), t * z - math.log(-switch) / t + 1.0 / t
    values = np.where(z <= switch, -np.log(-inside) / t, tangent)
    return values, lambda slope: slope / (-t * inside)  # the tangent has the slope t


RULE = CostRule(risk, critic_loss, penalty)
ALGORITHM = Algorithm("SAC-LB", SACLBConfig, RULE, OffPolicy, work=5.0)
