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
    """Growth of the multiplier's logarithm in a gradient step, by unit of risk above its limit."""


def law(config, multiplier, risk):
    """The multiplier after a gradient step, of that before [R, 32] and the risk [R, 1]."""
    return multiplier * (config.gain * (risk - config.cost_limit)).exp()


rule = RULE._replace(multipliers=(Multiplier(PROJECTED._replace(law=law)),))
agents.register("sac-mw", agents.Algorithm("SAC-MW", SACMWConfig, rule, OffPolicy))
