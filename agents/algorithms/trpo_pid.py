"""TRPO-PID: TRPO-Lag whose multiplier is set by a PID controller.

Source: Stooke, Achiam & Abbeel 2020, "Responsive safety in reinforcement learning by PID Lagrangian
methods", algorithm 2, with the step of TRPO as in OmniSafe.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from agents.algorithms import Algorithm
from agents.algorithms.trpo_lag import TRPOLagConfig, advantage, step
from agents.lockstep.lagrange import PROJECTED, Multiplier
from agents.trust_region import StepRule, TrustRegion


@dataclass(frozen=True)
class TRPOPIDConfig(TRPOLagConfig):
    """Hyper-parameters of TRPO-PID."""

    multiplier_optimizer: Literal["adam", "sgd", "pid"] = "pid"
    """How the multiplier follows the cost: a PID controller sets it (pid), which is the paper's
    idea. adam and sgd are TRPO-Lag whose multiplier follows before the policy improves."""


RULE = StepRule(advantage, step, (Multiplier(PROJECTED, ahead=True),))
ALGORITHM = Algorithm("TRPO-PID", TRPOPIDConfig, RULE, TrustRegion, work=1.0)
