"""Gymnasium: wrap an Env or VectorEnv to record costs, here those of a random policy."""

import gymnasium as gym

import circle2d_mj  # noqa: F401  # registers the task
import emcc

env = emcc.RecordCosts(gym.make("Circle2D-1-v0"))
env.action_space.seed(0)
for episode in range(200):
    env.reset(seed=episode)
    done = False
    while not done:
        _, _, terminated, truncated, _ = env.step(env.action_space.sample())
        done = terminated or truncated
print(emcc.panel(env.records, limit=5.0).to_markdown())
