"""IPO: interior-point policy optimisation, PPO with a log barrier on the discounted cost return.

Source: Liu, Ding & Liu 2020, "IPO: interior-point policy optimization under constraints".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import torch
from torch import Tensor

from agents.algorithms import Algorithm
from agents.algorithms.trpo_lag import advantage
from agents.checks import In
from agents.first_order import FirstOrder, Objective, PPOConfig
from agents.lockstep.lagrange import PROJECTED, Multiplier


@dataclass(frozen=True)
class IPOConfig(PPOConfig):
    """Hyper-parameters of IPO. The recorded multiplier is the slope of the barrier."""

    limited_cost = "discounted cost of an episode"  # in words, for tables

    cost_limit: Annotated[float, In(0, 1e9)] = 25.0
    """Limit d of the discounted cost of an episode, mean over an epoch's episodes, with the
    discount γ of the rewards."""
    log_barrier_factor: Annotated[float, In(1e-6, 1e6)] = 20.0
    """Factor t of the barrier, which approaches a hard constraint as t grows. Liu et al.: 20."""
    max_penalty: Annotated[float, In(0, 1e6)] = 1.0
    """Largest slope of the barrier; used also beyond the limit, where the barrier is undefined. 1
    as in OmniSafe."""
    kl_stop: Annotated[float, In(0, 1e12)] = 0.02
    """Mean KL divergence beyond which an epoch's passes of the actor end; 0: never. 0.02 as in
    OmniSafe."""
    max_gradient_norm: Annotated[float, In(above=0, high=1e12)] = 40.0
    """Norm to which the actor's gradient is clipped. 40 as in OmniSafe."""


def slope(config: IPOConfig, before: Tensor, cost: Tensor) -> Tensor:
    """`1 / (t (d - J_C))`: how fast the barrier `log(d - J_C) / t` falls in the cost J_C [R, 1]."""
    room = config.cost_limit - cost
    penalty = 1.0 / (config.log_barrier_factor * room)
    return torch.where(room > 0, penalty, torch.inf).clamp(max=config.max_penalty)


BARRIER = Multiplier(PROJECTED._replace(law=slope), ahead=True, discounted=True)
RULE = Objective(advantage, (BARRIER,))
ALGORITHM = Algorithm("IPO", IPOConfig, RULE, FirstOrder, work=2.4)
