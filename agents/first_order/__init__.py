"""The first-order family: on-policy algorithms that clip the surrogate and step by Adam."""

from agents.first_order.learner import FirstOrder as FirstOrder
from agents.first_order.update import Objective as Objective
from agents.first_order.update import PPOConfig as PPOConfig
