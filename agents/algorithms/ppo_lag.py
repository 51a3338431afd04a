"""PPO-Lag: proximal policy optimisation with a Lagrange multiplier on the episode cost.

Source: Ray, Achiam & Amodei 2019, "Benchmarking safe exploration in deep reinforcement learning".
Not in the paper's grid.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from agents.algorithms import Algorithm
from agents.algorithms.trpo_lag import advantage
from agents.first_order import FirstOrder, Objective, PPOConfig
from agents.lockstep.lagrange import PROJECTED, Gain, Multiplier, MultiplierConfig
from agents.lockstep.streaks import StreakTailLimit
from agents.on_policy.state import EpisodeCostLimit


@dataclass(frozen=True)
class PPOLagConfig(MultiplierConfig, StreakTailLimit, EpisodeCostLimit, PPOConfig):
    """Hyper-parameters of PPO-Lag."""

    initial_multiplier: Annotated[float, Gain] = 0.001
    """Initial multiplier λ, at least 0. Not in the paper; 0.001 as in OmniSafe and TRPO-Lag."""
    multiplier_lr: Annotated[float, Gain] = 0.035
    """Step size of the multiplier with adam or sgd. Not in the paper; 0.035 as in OmniSafe."""
    multiplier_optimizer: Literal["adam", "sgd", "pid"] = "adam"
    """How the multiplier follows the cost: it ascends by Adam or by the plain gradient (sgd), or a
    PID controller sets it (pid; Stooke et al. 2020). Not in the paper; adam as in OmniSafe."""


RULE = Objective(advantage, (Multiplier(PROJECTED),))
ALGORITHM = Algorithm("PPO-Lag", PPOLagConfig, RULE, FirstOrder, work=2.4)
