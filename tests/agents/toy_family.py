"""A user-defined family of algorithms: linear policies in NumPy, trained by a made-up rule.

It is deterministic, draws noise by seed and epoch, has a state that every update changes, and fails
on request in several ways. No run depends on the others.
"""

import contextlib
import sys
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from agents import algorithms
from agents.algorithms import Algorithm, register


@dataclass(frozen=True)
class Numbers:
    """Hyper-parameters of the family."""

    episodes: int = 1
    "Episodes of an epoch."
    cost_limit: float = 5.0
    "Limit of the cost."
    wrong: str = ""
    "What goes wrong in the second epoch: learn, exit, act, action, nan, reduce."


class Rule(NamedTuple):
    """The number of costs that are limited."""

    costs: int = 1


class Linear:
    """Policies whose actions are linear in the observation; each run has its own noise."""

    metrics = ("loss", "size")

    def __init__(self, config, rule, seeds, observation_size, action_size):
        self.config, self.seeds, self.episodes = config, seeds, config.episodes
        rngs = [np.random.default_rng(seed) for seed in seeds]
        shape = (action_size, observation_size)
        self.actor = np.array([rng.normal(0, 0.3, shape) for rng in rngs])
        self.moment = np.zeros_like(self.actor)
        self.wrong = lambda epoch, how: config.wrong == how and epoch >= 1

    def policy(self):
        actor = self.actor.copy()

        def act(observation, noise):
            mean = np.stack([o @ a.T for o, a in zip(observation, actor, strict=True)])
            return (mean + (0 if noise is None else 0.3 * noise)).astype(np.float32)

        return act

    def explorer(self, epoch, steps):
        rngs = [np.random.default_rng([seed, epoch, 1]) for seed in self.seeds]
        act, runs = self.policy(), len(self.seeds)

        def explore(observation):
            if self.wrong(epoch, "act"):
                raise ZeroDivisionError("nothing to act by")
            observation = observation.reshape(runs, self.episodes, -1)
            shape = (self.episodes, self.actor.shape[1])
            action = act(observation, np.stack([rng.normal(size=shape) for rng in rngs]))
            if self.wrong(epoch, "action"):
                action[0] = np.nan
            return action.reshape(runs * self.episodes, -1)

        return explore

    def learn(self, rollout, epoch, active):
        if self.wrong(epoch, "learn"):
            raise ZeroDivisionError("nothing to learn from")
        if self.wrong(epoch, "exit"):
            sys.exit(0)
        metrics = np.full((len(active), 2), np.nan)
        for run in np.flatnonzero(active):
            own = range(run * self.episodes, (run + 1) * self.episodes)
            seen = np.concatenate([rollout.observation[: rollout.length[k], k] for k in own])
            gain = rollout.returns[own].mean() - rollout.cost_returns[own, 0].mean()
            self.moment[run] = 0.5 * self.moment[run] + 0.01 * gain * seen.mean(axis=0)
            self.actor[run] += self.moment[run] / (1 + np.abs(self.moment[run]))
            metrics[run] = gain, np.abs(self.actor[run]).sum()
        if self.config.wrong == "reduce":
            self.actor += 0.1 * self.actor.mean(axis=0)
        if self.wrong(epoch, "nan"):
            self.actor[0] = np.nan
        return metrics

    def finite(self):
        return np.isfinite(self.actor).all(axis=(1, 2))

    def state_dict(self):
        return {"actor": self.actor.copy(), "moment": self.moment.copy()}

    def load_state_dict(self, state):
        for name in ("actor", "moment"):
            if state[name].shape != self.actor.shape:
                raise ValueError(f"{name} has another shape")
            setattr(self, name, state[name].copy())


@contextlib.contextmanager
def known(name="toy", algorithm=None):
    """Register an algorithm, by default the toy one, in this context."""
    register(name, algorithm or Algorithm("Toy", Numbers, Rule(), Linear))
    try:
        yield
    finally:
        algorithms._algorithms.registered.pop(name, None)
        algorithms._algorithms.modules.pop(name, None)
