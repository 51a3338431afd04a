"""Minari: a data set recorded with infos holds the cost of each step."""

import gymnasium as gym
import minari

import circle2d_mj  # noqa: F401  # registers the task
import emcc

env = minari.DataCollector(gym.make("Circle2D-1-v0"), record_infos=True)
for episode in range(100):
    env.reset(seed=episode)
    done = False
    while not done:
        _, _, terminated, truncated, _ = env.step(env.action_space.sample())
        done = terminated or truncated
dataset = env.create_dataset("circle2d/random-v0", algorithm_name="random policy")
print(emcc.panel(emcc.from_minari(dataset), limit=5.0).to_markdown())
minari.delete_dataset("circle2d/random-v0")
