"""SAC-LB tuned: SAC-LB with other hyper-parameters and a margin below the limit.

SAC-LB as in the paper's grid stays in the local optima of levels 2 and 3. What keeps it there is
not its constraint: small tanh networks blur positions in [-1, 1], and white random actions never
show it the corridor. Larger inputs, brown random actions, a replay of the whole training and more,
smaller gradient steps lead it out; the margin keeps it within the limit while it learns. Source of
the barrier: Zhang et al. 2024 (see `sac_lb`). `results/solve/README.md` has the trials.
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
class SACLBTunedConfig(SACLBConfig):
    """Hyper-parameters of SAC-LB tuned: SAC-LB's with other defaults, and the margin."""

    learning_rate: float = 1e-3
    """Adam's step size for actor, critics and temperature. The paper's SAC-LB: 3e-4."""
    batch_size: int = 128
    """Transitions a gradient step; a multiple of 32, at most the replay's size. The paper's
    SAC-LB: 256."""
    gradient_steps: int = 10
    """Gradient steps an epoch, which is one episode. The paper's SAC-LB: 5."""
    random_exponent: float = 2.0
    """Exponent β of the random actions' power spectrum 1/f^β: 2 is brown noise, which keeps a
    direction for many steps. The paper's SAC-LB: 0."""
    replay_size: int = 1_000_000
    """Transitions the replay of a run holds: the whole of a training. The paper's SAC-LB: 50000."""
    input_scale: float = 15.0
    """Factor on observations before the networks; 15 turns Circle2D's back into its units of
    length. The paper's SAC-LB: 1."""
    margin: float = 0.2
    """Share of the cost limit that the barrier keeps free, in [0, 1): it stands at
    `(1 - margin) d`. The paper's SAC-LB: 0."""

    def __post_init__(self) -> None:
        """Raises UserError naming the value that is not allowed."""
        super().__post_init__()
        check(self, "margin", low=0, high=0.99)


def penalty(config: SACLBTunedConfig, risk: Tensor, multiplier: Tensor) -> Tensor:
    """`ψ(max Q_c - (1 - margin) d)`."""
    barrier = (1.0 - config.margin) * config.cost_limit
    return log_barrier(risk - barrier, config.log_barrier_factor)


RULE = CostRule(risk, critic_loss, penalty)
ALGORITHM = Algorithm("SAC-LB tuned", SACLBTunedConfig, RULE, OffPolicy)
