"""TRPO-Sauté: TRPO with observations augmented by the remaining cost budget of the episode.

Source: Sootla et al. 2022, "Sauté RL: almost surely safe reinforcement learning using state
augmentation", with the budget of OmniSafe's adapter.
"""

from __future__ import annotations

from dataclasses import dataclass

from agents.algorithms import Algorithm
from agents.algorithms.ppo_saute import SauteConfig, advantage
from agents.algorithms.trpo_lag import step
from agents.trust_region import StepRule, TRPOConfig, TrustRegion


@dataclass(frozen=True)
class TRPOSauteConfig(SauteConfig, TRPOConfig):
    """Hyper-parameters of TRPO-Sauté."""


RULE = StepRule(advantage, step, costs=0)  # what costs change is in the state and the reward
ALGORITHM = Algorithm("TRPO-Sauté", TRPOSauteConfig, RULE, TrustRegion, work=1.0)
