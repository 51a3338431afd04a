"""The off-policy family: soft actor-critic with cost critics."""

from agents.sac.config import ConstrainedSACConfig as ConstrainedSACConfig
from agents.sac.config import SACConfig as SACConfig
from agents.sac.learner import OffPolicy as OffPolicy
from agents.sac.update import CostRule as CostRule
