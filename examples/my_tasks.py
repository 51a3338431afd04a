"""A custom task: stay near 0; steps beyond a distance of 1 cost."""

import gymnasium as gym
import numpy as np


class StayView:
    """View of the line, from left to right; grey where steps cost."""

    extent = (-10.0, 10.0, -10.0, 10.0)  # left, right, bottom, top
    axes = ("x", "")

    def positions(self, observation, info):
        """Return positions [..., 2] for observations [..., 1]."""
        return np.concatenate([observation, np.zeros_like(observation)], axis=-1)

    def places(self, positions):
        """Return the names of the places where episodes end; [] for no names."""
        return ["middle" if abs(x) <= 1 else "outside" for x, _ in positions]

    def background(self, size):
        """Paint the background of heat maps and trajectories."""
        x = np.linspace(-10, 10, size)[None, :, None]
        return np.where(abs(x) > 1, 220, 255).astype(np.uint8) + np.zeros((size, 1, 3), np.uint8)

    def overlay(self, picture):
        """Paint what is drawn on top: nothing."""
        return picture


class Stay(gym.Env):
    """A point on a line, pushed by a random force."""

    view = StayView()
    observation_space = gym.spaces.Box(-10.0, 10.0, (1,), np.float32)
    action_space = gym.spaces.Box(-1.0, 1.0, (1,), np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x = 0.0
        return np.array([self.x], np.float32), {"cost": 0.0}

    def step(self, action):
        self.x = float(np.clip(self.x + action[0] + self.np_random.normal(), -10.0, 10.0))
        info = {"cost": float(abs(self.x) > 1.0)}
        return np.array([self.x], np.float32), -abs(self.x), False, False, info


gym.register("Stay-v0", Stay, max_episode_steps=20)
