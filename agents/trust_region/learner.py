"""The trust-region family: on-policy algorithms whose policy takes one natural-gradient step."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from agents.on_policy.learner import OnPolicy
from agents.on_policy.state import Epoch, OnPolicyState
from agents.trust_region.policy_step import StepRule, TRPOConfig, policy_step


class TrustRegion(OnPolicy):
    """The runs of one algorithm of the trust-region family."""

    takes = (TRPOConfig, StepRule)
    improvement_metrics = ("kl", "step_scale")
    """A step_scale of 0: the line search found nothing, and the policy stayed as it was."""

    def __init__(
        self,
        config: TRPOConfig,
        rule: StepRule,
        seeds: Sequence[int],
        observation_size: int,
        action_size: int,
    ) -> None:
        super().__init__(config, rule, seeds, observation_size, action_size)
        if rule.has_cases:
            self.metrics = (*self.metrics, "case")

    def improve(
        self, epoch: Epoch, steps: NDArray[np.int64], generators: list[np.random.Generator]
    ) -> tuple[OnPolicyState, dict[str, Tensor]]:
        """One step of the policy, from all of the epoch at once."""
        actor, records = policy_step(self.nets, self.config, self.rule, self._state, epoch)
        return self._state._replace(actor=actor), records
