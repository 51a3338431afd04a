"""CPPO-PID: PPO-Lag whose multiplier is set by a PID controller.

Source: Stooke, Achiam & Abbeel 2020, "Responsive safety in reinforcement learning by PID Lagrangian
methods", algorithm 2.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from agents.algorithms import Algorithm
from agents.algorithms.ppo_lag import PPOLagConfig, advantage
from agents.first_order import FirstOrder, Objective
from agents.lockstep.lagrange import PROJECTED, Multiplier


@dataclass(frozen=True)
class CPPOPIDConfig(PPOLagConfig):
    """Hyper-parameters of CPPO-PID."""

    multiplier_optimizer: Literal["adam", "sgd", "pid"] = "pid"
    """How the multiplier follows the cost: a PID controller sets it (pid), which is the paper's
    idea. adam and sgd are PPO-Lag whose multiplier follows before the policy improves."""


RULE = Objective(advantage, (Multiplier(PROJECTED, ahead=True),))
ALGORITHM = Algorithm("CPPO-PID", CPPOPIDConfig, RULE, FirstOrder, work=2.4)
