"""Tianshou: the collector's buffer holds the cost of every step."""

import gymnasium as gym
import numpy as np
from tianshou.algorithm.algorithm_base import RandomActionPolicy
from tianshou.data import Collector, ReplayBuffer

import circle2d_mj  # noqa: F401  # registers the task
import emcc

env = gym.make("Circle2D-1-v0")
buffer = ReplayBuffer(size=5000)
policy = RandomActionPolicy(env.action_space)
Collector(policy, env, buffer).collect(n_episode=100, reset_before_collect=True)
lengths = np.diff(np.flatnonzero(buffer.done), prepend=-1)
records = emcc.EpisodeRecords.from_costs(buffer.info.cost, lengths, buffer.rew)
print(emcc.panel(records, limit=5.0).to_markdown())
