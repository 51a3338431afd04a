"""CPO as OmniSafe 0.5 has it: the growth of the cost is that of a step, its excess of an episode.

With episodes of 1000 steps the limit's plane then hardly ever cuts the trust region. Within the
limit a step is TRPO's; beyond it, it follows the cost alone.

circle2d train cpo-omnisafe --import omnisafe_cpo ...
"""

import agents
from agents.algorithms import cpo
from agents.trust_region import TrustRegion


class CostsOfAStep(TrustRegion):
    """The family, for which an episode is one step long where it predicts costs."""

    def improve(self, epoch, steps, generators):
        """Its step, without the factor of the episodes' length."""
        taking_part = (epoch.length > 0).to(epoch.length.dtype)
        return super().improve(epoch._replace(length=taking_part), steps, generators)


agents.register(
    "cpo-omnisafe", agents.Algorithm("CPO-OmniSafe", cpo.CPOConfig, cpo.RULE, CostsOfAStep)
)
