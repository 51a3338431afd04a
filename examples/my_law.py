"""SAC-MW: SAC-Lag whose multiplier grows or shrinks by a factor."""

from dataclasses import dataclass

import agents
from agents.algorithms.sac_lag import RULE
from agents.lockstep.lagrange import PROJECTED, Multiplier
from agents.sac import ConstrainedSACConfig, OffPolicy


@dataclass(frozen=True)
class SACMWConfig(ConstrainedSACConfig):
    """Hyper-parameters of SAC-MW."""

    initial_multiplier: float = 0.1
    """Multiplier at the start; above 0."""
    gain: float = 1e-3
    """Growth of the multiplier's logarithm per gradient step and unit of risk above the limit."""


def law(config, multiplier, risk):
    """Return the multiplier after a gradient step, [R, 32]; multiplier: before it; risk: [R, 1]."""
    return multiplier * (config.gain * (risk - config.cost_limit)).exp()


rule = RULE._replace(multipliers=(Multiplier(PROJECTED._replace(law=law)),))
agents.register("sac-mw", agents.Algorithm("SAC-MW", SACMWConfig, rule, OffPolicy))
