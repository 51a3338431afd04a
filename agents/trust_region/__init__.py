"""The trust-region family: natural-gradient steps of the policy."""

from agents.trust_region.learner import TrustRegion as TrustRegion
from agents.trust_region.policy_step import StepRule as StepRule
from agents.trust_region.policy_step import TRPOConfig as TRPOConfig
