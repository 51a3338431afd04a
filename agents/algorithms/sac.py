"""SAC: soft actor-critic, without a constraint: a baseline for the others.

Source: Haarnoja et al. 2018, "Soft actor-critic algorithms and applications".
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from agents.algorithms import Algorithm
from agents.algorithms.sac_lag import critic_loss, risk
from agents.lockstep.kernel import Float
from agents.lockstep.pulled import Pull, closed_form
from agents.sac import CostRule, OffPolicy, SACConfig


def penalty(config: SACConfig, risk: Tensor, multipliers: Tensor) -> Tensor:
    """Return no penalties, of no risks: costs are recorded but not learned."""
    return torch.zeros_like(risk)


@closed_form(penalty)
def _penalty(config: SACConfig, risk: Float, multipliers: Float) -> tuple[Float, Pull]:
    return np.zeros_like(risk), np.zeros_like


RULE = CostRule(risk, critic_loss, penalty, costs=0, limits=())
ALGORITHM = Algorithm("SAC", SACConfig, RULE, OffPolicy, work=4.8)
