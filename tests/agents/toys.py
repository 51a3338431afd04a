"""Small tasks on which tests train."""

import contextlib
import os
import sys
import time

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Box


class Target(gym.Env):
    """Episodes of one step: reward -(a - 0.8)² plus noise, cost (1 + a) / 2, a in [-1, 1].

    With a cost limit of 0.6 the best action is a = 0.2 and the multiplier there is 2.4, at which
    both slopes are equal: 2 (0.8 - 0.2) = λ / 2. The cost is linear, so that the policy's noise
    does not move the optimum.
    """

    observation_space = Box(-1.0, 1.0, (1,))
    action_space = Box(-1.0, 1.0, (1,))

    def __init__(self, noise=0.0):
        self.noise = noise

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return np.zeros(1, np.float32), {}

    def step(self, action):
        a = float(action[0])
        assert -1 <= a <= 1
        reward = -((a - 0.8) ** 2) + self.np_random.normal(0, self.noise)
        return np.zeros(1, np.float32), reward, True, False, {"cost": (1 + a) / 2}


class Walk(gym.Env):
    """A walk on a line that ends early: when |x| > 1, or after at most 40 steps.

    Actions in [-2, 2] move x by a tenth of the action plus noise; a step with x > 0.5 costs 1.
    Observations are float64. With probability `poison`, a step goes wrong as `poisons` says: its
    reward, cost or observation is NaN, its cost is negative, or it raises an error or exits.
    """

    observation_space = Box(-np.inf, np.inf, (2,), np.float64)
    action_space = Box(-2.0, 2.0, (1,))

    def __init__(self, poison=0.0, poisons="reward", scale=1.0):
        """scale: a factor on observations, or one for each of the two numbers observed."""
        self.poison, self.poisons, self.scale = poison, poisons, scale

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x, self.t = self.np_random.uniform(-0.5, 0.5), 0
        return self.observation(), {}

    def observation(self):
        return np.asarray(self.scale) * np.array([self.x, self.t / 40])

    def step(self, action):
        assert self.action_space.contains(np.asarray(action, np.float32)), action
        self.x += 0.1 * float(action[0]) + self.np_random.normal(0, 0.1)
        self.t += 1
        out = abs(self.x) > 1
        given = {"reward": self.x, "cost": float(self.x > 0.5), "observation": self.observation()}
        if self.np_random.random() < self.poison:
            if self.poisons == "raise":
                raise FloatingPointError("unstable")
            if self.poisons == "exit":
                sys.exit(0)
            if self.poisons == "negative":
                given["cost"] = -1.0
            else:
                given[self.poisons] *= np.nan
        info = {"cost": float(given["cost"])}
        return given["observation"], float(given["reward"]), out, not out and self.t == 40, info


class Broken(gym.Env):
    """Episodes of 20 steps; from step `at` on, counted over an environment's episodes, it fails.

    how: "raise", "exit", "die", "hang", "reset" (the next reset raises), "init" (it cannot be made)
    or what is wrong with the step: "observation", "reward", "complex", "cost", "missing",
    "negative".
    """

    observation_space = Box(-1.0, 1.0, (2,))
    action_space = Box(-1.0, 1.0, (1,))

    def __init__(self, how="never", at=50):
        if how == "init":
            raise LookupError("no licence")
        self.how, self.at, self.taken = how, at, 0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.t = 0
        if self.how == "reset" and self.taken >= self.at:
            raise LookupError("door\nclosed")
        return np.zeros(2, np.float32), {}

    def step(self, action):
        self.t, self.taken = self.t + 1, self.taken + 1
        observation, reward, info = np.zeros(2, np.float32), float(action[0]), {"cost": 0.5}
        if self.taken >= self.at:
            if self.how == "raise":
                raise LookupError("motor\nbroken")
            if self.how == "exit":
                sys.exit(0)
            if self.how == "die":
                os._exit(3)
            if self.how == "hang":
                time.sleep(60)
            observation = np.zeros(3, np.float32) if self.how == "observation" else observation
            reward = {"reward": np.zeros(2), "complex": 1j}.get(self.how, reward)
            info = {"cost": {"cost": "much", "negative": -1.0}.get(self.how, 0.5)}
            info = {} if self.how == "missing" else info
        return observation, reward, False, self.t == 20, info


class TwoCosts(Walk):
    """A walk with a second cost: a step with x < -0.25 costs a quarter."""

    def step(self, action):
        *others, info = super().step(action)
        return *others, info | {"cost_2": 0.25 * (self.x < -0.25)}


class Pressed(Walk):
    """A walk that has x recorded at each step, and by how much x exceeds 0.5."""

    recorded_info = {"x": "m", "beyond": "m"}  # noqa: RUF012

    def step(self, action):
        *others, info = super().step(action)
        return *others, info | {"x": self.x, "beyond": max(self.x - 0.5, 0.0)}


@contextlib.contextmanager
def registered(**classes):
    """Register tasks with gymnasium in this context, by their names without "-v0"."""
    for name, cls in classes.items():
        gym.register(f"{name}-v0", cls, disable_env_checker=True)
    try:
        yield
    finally:
        for name in classes:
            del gym.registry[f"{name}-v0"]


def register():
    """Register this module's tasks with gymnasium, as `Target-v0` and so on."""
    for cls in (Target, Walk, Broken, TwoCosts, Pressed):
        if f"{cls.__name__}-v0" not in gym.registry:
            gym.register(f"{cls.__name__}-v0", entry_point=cls, disable_env_checker=True)
