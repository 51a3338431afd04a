"""The process that `test_compiled` starts, where PyTorch may compile: prints JSON."""

import json
import sys
import tempfile
from pathlib import Path

import numpy as np
from small_trainings import assert_same, finished, trainer
from test_families import arrays_of, config

from agents.algorithms import learner
from agents.lockstep import backend
from agents.lockstep.backend import CLOCK
from agents.lockstep.rollout import collect
from agents.training.environments import make_envs

UPDATES, SEEDS = 20, (0, 1, 2)


def rollout_of(one, episodes):
    """Episodes of a policy that knows nothing, of different lengths."""
    envs = make_envs(one.tasks[0], len(SEEDS) * episodes, {})
    rng = np.random.default_rng(0)

    def act(observation):
        return rng.uniform(-1, 1, (len(observation), 1)).astype(np.float32)

    return collect(envs, range(len(SEEDS) * episodes), act)


def trained(name, runs, compiles, states=None):
    """The states of the first `runs` runs before and after each update from the same episodes.

    states: those to begin each update with; by default what the update before came to.
    """
    backend.configure(compiles)
    one = config(name, SEEDS[:runs])
    agent = learner(one.algorithm, one.hyperparameters, one.seeds, 2, 1)
    rollout = rollout_of(one, agent.episodes).of(slice(0, runs * agent.episodes))
    found = [copied(agent.state_dict())]
    for epoch in range(UPDATES):
        if states:
            agent.load_state_dict(states[epoch])
        agent.learn(rollout, epoch, np.ones(runs, dtype=bool))
        found.append(copied(agent.state_dict()))
    return found


def copied(state):
    return {name: array.copy() for name, array in state.items()}


def difference(a, b):
    """The largest of parameters."""
    assert a.keys() == b.keys()
    learned = ("actor", "critics", "multipliers.0.parameter", "multipliers.0.value")
    names = [name for name in a if name in learned]
    return max(float(np.abs(a[name] - b[name]).max()) for name in names)


def resumed_is_as_never_stopped(name):
    backend.configure(True)
    whole = finished(trainer(config(name, SEEDS)))
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "run"
        stopped = trainer(config(name, SEEDS), folder)
        while stopped.steps.min() < 100:
            stopped.run_epoch()
        stopped.save()
        resumed = trainer(config(name, SEEDS), folder)
        resumed.load()
    assert_same(arrays_of(finished(resumed)), arrays_of(whole))


def main(names):
    found, first = {}, []
    for name in names:
        eager = trained(name, 3, False)
        single = trained(name, 3, True, eager)
        of_all = trained(name, 3, True)
        first = first or of_all
        updates = [*map(difference, single[1:], eager[1:])]
        found[name] = {
            "moved": difference(eager[-1], eager[0]),
            "median update": float(np.median(updates)),
            "worst update": max(updates),
            "all updates": difference(of_all[-1], eager[-1]),
            "seconds of compiling": CLOCK.seconds,
        }
    name = names[0]
    for runs in (1, 2):
        of_some = trained(name, runs, True)[-1]
        learned = {k: v for k, v in of_some.items() if not k.startswith("replay")}
        assert_same(learned, {k: first[-1][k][:runs] for k in learned})
    resumed_is_as_never_stopped(name)
    print(json.dumps(found))


if __name__ == "__main__":
    main(sys.argv[1:])
