"""SAC-LB with a margin: its barrier stands below the limit, and its networks see detail.

SAC-LB as in the paper's grid stays in Circle2D's local optima. Three changes lead it out: inputs
large enough for small tanh networks to tell places apart, a larger step size, and a replay that
forgets nothing of the paper's training. The margin keeps it within the limit while it learns.
Source of the barrier: Zhang et al. 2024 (see `sac_lb`); the changes were found by trial, which
`results/solve/README.md` reports.
"""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from agents.algorithms import Algorithm
from agents.algorithms.sac_lag import critic_loss, risk
from agents.algorithms.sac_lb import SACLBConfig, log_barrier
from agents.errors import check
from agents.sac import CostRule, OffPolicy


@dataclass(frozen=True)
class SACLBMarginConfig(SACLBConfig):
    """Hyper-parameters of SAC-LB with a margin."""

    learning_rate: float = 1e-3
    """Adam's step size for actor, critics and temperature; about three times the paper's."""
    replay_size: int = 1_000_000
    """Transitions the replay of a run holds: all of a training of the paper's length."""
    input_scale: float = 15.0
    """Factor on observations before the networks; 15 turns Circle2D's back into its units of
    length. Small tanh networks are smooth: see `SACConfig`."""
    margin: float = 0.4
    """Share of the cost limit that the barrier keeps free, in [0, 1): it stands at
    `(1 - margin) d`."""

    def __post_init__(self) -> None:
        """Raises UserError naming the value that is not allowed."""
        super().__post_init__()
        check(self, "margin", low=0, high=0.99)


def penalty(config: SACLBMarginConfig, risk: Tensor, multiplier: Tensor) -> Tensor:
    """`ψ(max Q_c - (1 - margin) d)`."""
    barrier = (1.0 - config.margin) * config.cost_limit
    return log_barrier(risk - barrier, config.log_barrier_factor)


RULE = CostRule(risk, critic_loss, penalty)
ALGORITHM = Algorithm("SAC-LB with margin", SACLBMarginConfig, RULE, OffPolicy)
