"""The off-policy family: soft actor-critic with cost critics."""

from agents.sac.learner import OffPolicy as OffPolicy
from agents.sac.update import ConstrainedSACConfig as ConstrainedSACConfig
from agents.sac.update import CostRule as CostRule
from agents.sac.update import MultiplierOfConfig as MultiplierOfConfig
from agents.sac.update import SACConfig as SACConfig
