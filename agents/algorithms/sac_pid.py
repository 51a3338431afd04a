"""SAC-PID: SAC-Lag whose multiplier is set by a PID controller.

Source: Stooke, Achiam & Abbeel 2020, "Responsive safety in reinforcement learning by PID Lagrangian
methods", algorithm 2, with SAC as in OmniSafe.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from agents.algorithms import Algorithm
from agents.algorithms.sac_lag import RULE, SACLagConfig
from agents.sac import OffPolicy


@dataclass(frozen=True)
class SACPIDConfig(SACLagConfig):
    """Hyper-parameters of SAC-PID."""

    multiplier_optimizer: Literal["adam", "sgd", "pid"] = "pid"
    """How the multiplier follows the cost: a PID controller sets it once an epoch (pid), which is
    the paper's idea. adam and sgd are SAC-Lag."""


ALGORITHM = Algorithm("SAC-PID", SACPIDConfig, RULE, OffPolicy, work=5.0)
