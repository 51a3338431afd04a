"""The first-order family: on-policy algorithms whose policy takes minibatch steps of Adam."""

from agents.first_order.learner import FirstOrder as FirstOrder
from agents.first_order.update import FirstOrderConfig as FirstOrderConfig
from agents.first_order.update import Objective as Objective
from agents.first_order.update import PPOConfig as PPOConfig
