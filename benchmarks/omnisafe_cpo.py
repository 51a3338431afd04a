"""CPO as in OmniSafe 0.5, which compares a change of cost per step with an excess per episode.

With episodes of 1000 steps, the constraint's hyperplane then hardly ever cuts the trust region. If
the policy satisfies the constraint, the update is TRPO's; otherwise it only lowers the cost.

circle2d train cpo-omnisafe --import omnisafe_cpo ...
"""

import agents
from agents.algorithms import cpo
from agents.trust_region import TrustRegion


class CostsOfAStep(TrustRegion):
    """The trust-region family with episode length 1 in the prediction of costs."""

    def improve(self, epoch, steps, generators):
        """Update the policy without the factor of the episodes' length."""
        taking_part = (epoch.length > 0).to(epoch.length.dtype)
        return super().improve(epoch._replace(length=taking_part), steps, generators)


agents.register(
    "cpo-omnisafe", agents.Algorithm("CPO-OmniSafe", cpo.CPOConfig, cpo.RULE, CostsOfAStep)
)
