"""SAC-Lag as in a later library of the paper's group: the multiplier follows the cost critics at
actions from the replay buffer, taken by older policies, instead of at the current policy's actions.

Source: 2BH/saferl-lib, commit 6163e2e, `saferl/algorithms/sac_lag/sac_lag.py`. The library follows
the mean of both cost critics, this file the larger one. Results: results/library.
"""

import agents
from agents.algorithms import sac_lag
from agents.sac import OffPolicy


def unchanged(config, multipliers, risks_of_replayed_actions):
    """Return the multipliers for the actor, unchanged. A rule with such a function makes the
    multipliers follow the risks of replayed actions."""
    return multipliers


rule = sac_lag.RULE._replace(augmented=unchanged)
agents.register(
    "sac-lag-library",
    agents.Algorithm("SAC-Lag-library", sac_lag.SACLagConfig, rule, OffPolicy),
)
