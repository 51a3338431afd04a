"""TRPO-Price: TRPO-Lag with a fixed price of cost added to its multiplier."""

from dataclasses import dataclass

import agents
from agents.algorithms.trpo_lag import TRPOLagConfig, step
from agents.lockstep.lagrange import PROJECTED, Multiplier
from agents.trust_region import StepRule, TrustRegion


@dataclass(frozen=True)
class TRPOPriceConfig(TRPOLagConfig):
    """Hyper-parameters of TRPO-Price."""

    price: float = 0.1
    """Price of cost, added to the multiplier."""


def advantage(config, reward_advantage, cost_advantage, multipliers):
    """Combine advantages of the reward [R, B] and the cost [R, 1, B] into [R, B]."""
    weight = multipliers + config.price
    return (reward_advantage - weight * cost_advantage[:, 0]) / (1.0 + weight)


rule = StepRule(advantage, step, (Multiplier(PROJECTED),))
agents.register("trpo-price", agents.Algorithm("TRPO-Price", TRPOPriceConfig, rule, TrustRegion))
