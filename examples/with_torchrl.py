"""TorchRL: each batch of the collector is a rollout between two updates of the policy."""

from torchrl.collectors import Collector
from torchrl.envs import GymEnv

import circle2d_mj  # noqa: F401  # registers the task
import emcc

env = GymEnv("Circle2D-1-v0")
env.auto_register_info_dict()  # otherwise batches lack the cost
collector = Collector(env, None, frames_per_batch=500, total_frames=5000)
batches = [batch.select(("next", "cost"), ("next", "reward"), ("next", "done"))
    for batch in collector]  # fmt: skip
collector.shutdown()
print(emcc.panel(emcc.from_tensordict(batches), limit=5.0).to_markdown())
