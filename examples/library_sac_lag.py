"""SAC-Lag as a later library of the paper's group has it: the multiplier follows the cost critics
at the replay's actions, which older policies took, instead of at the policy's own.

Source: 2BH/saferl-lib, commit 6163e2e, `saferl/algorithms/sac_lag/sac_lag.py`. It follows the mean
of both cost critics, this the larger. Results: results/library.
"""

import agents
from agents.algorithms import sac_lag
from agents.sac import OffPolicy


def unchanged(config, multipliers, risks_of_replayed_actions):
    """The actor sees the multiplier itself; a rule with this function follows those risks."""
    return multipliers


rule = sac_lag.RULE._replace(augmented=unchanged)
agents.register(
    "sac-lag-library",
    agents.Algorithm("SAC-Lag-library", sac_lag.SACLagConfig, rule, OffPolicy),
)
