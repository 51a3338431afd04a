"""Environments whose costs are known."""

import gymnasium as gym
import numpy as np


class Scripted(gym.Env):
    """Plays the episodes of its script in turn; even ones terminate, odd ones are truncated.

    script: the costs of the steps of each episode. The observation is the number of the episode
    and of its steps so far. The info of a reset holds a cost of 9, which must never count.
    """

    observation_space = gym.spaces.Box(0, 9, (2,), np.float32)
    action_space = gym.spaces.Discrete(2)

    def __init__(self, script, reset_cost=True, step_cost=True):
        self.script, self.episode = script, -1
        self.reset_cost, self.step_cost = reset_cost, step_cost

    def _observation(self):
        return np.array([self.episode, self.at], np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.episode, self.at = (self.episode + 1) % len(self.script), 0
        return self._observation(), {"cost" if self.reset_cost else "other": 9.0}

    def step(self, action):
        costs = self.script[self.episode]
        info = {"cost": costs[self.at]} if self.step_cost else {"other": 1.0}
        self.at += 1
        done, odd = self.at == len(costs), bool(self.episode % 2)
        return self._observation(), 0.5, done and not odd, done and odd, info


def follow(envs, rows, names):
    """Check 30 steps of a wrapped vector environment of `Scripted`, in its autoreset mode.

    rows: for each environment, episode and step, a pair: the values of `names` in the info, and
    what the wrapper appends to the observation. A step that only resets gives zeros. Returns the
    last info.
    """
    mode, count = envs.metadata["autoreset_mode"].value, len(rows)
    place = [[0, 0] for _ in range(count)]  # episode and steps taken of each environment
    waits = [False] * count
    for _ in range(30):
        if mode == "Disabled" and any(waits):
            observations, _ = envs.reset(options={"reset_mask": np.array(waits)})
            assert (observations[waits, 2:] == 0).all()
            waits = [False] * count
        observations, _, terminated, truncated, info = envs.step(np.zeros(count, int))
        for i in range(count):
            if waits[i]:
                assert [info[name][i] for name in names] == [0] * len(names)
                assert (observations[i, 2:] == 0).all()
                waits[i] = False
                continue
            episode, at = place[i]
            values, shown = rows[i][episode][at]
            assert [info[name][i] for name in names] == list(values)
            over = at + 1 == len(rows[i][episode])
            assert terminated[i] + truncated[i] == over
            place[i] = [(episode + 1) % len(rows[i]), 0] if over else [episode, at + 1]
            seen = observations[i]
            if over and mode == "SameStep":
                assert (seen[2:] == 0).all()
                assert [info["final_info"][name][i] for name in names] == list(values)
                seen = info["final_obs"][i]
            assert seen.tolist() == [episode, at + 1, *shown]
            waits[i] = bool(over and mode != "SameStep")
    return info


class TwoCosts(gym.Wrapper):
    """Adds a second cost: 1 in steps where the first is 0, otherwise 0."""

    def step(self, action):
        *rest, info = self.env.step(action)
        return *rest, info | {"cost_2": float(info["cost"] == 0)}


class Noisy(gym.Env):
    """Episodes of random length and cost.

    log: a list to which each step appends (number of the environment, cost, reward, whether the
    episode ended).
    """

    observation_space = gym.spaces.Box(-1, 1, (2,), np.float32)
    action_space = gym.spaces.Box(-1, 1, (1,), np.float32)

    def __init__(self, log, number=0, longest=30):
        self.log, self.number, self.longest = log, number, longest
        self.rng = np.random.default_rng(number)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.left = int(self.rng.integers(1, self.longest))
        return np.zeros(2, np.float32), {"cost": np.float64(77)}

    def step(self, action):
        self.left -= 1
        cost = np.float64(self.rng.random() < 0.4)
        reward = float(self.rng.integers(5))  # exact in any precision
        self.log.append((self.number, float(cost), reward, self.left == 0))
        return np.zeros(2, np.float32), reward, self.left == 0, False, {"cost": cost}


def trajectories(log):
    """Split a log of `Noisy` into trajectories of (costs, rewards): [ended, still running]."""
    running, ended = {}, []
    for number, cost, reward, done in log:
        running.setdefault(number, []).append((cost, reward))
        if done:
            ended.append(running.pop(number))
    return [[list(zip(*steps, strict=True)) for steps in of] for of in (ended, running.values())]
