"""What `test_compiled` runs in a process of its own, where PyTorch may compile: prints JSON."""

import json
import sys
import tempfile
from pathlib import Path

import numpy as np
from test_families import arrays_of, assert_same, config, finished

from agents.algorithms import learner
from agents.lockstep import backend
from agents.lockstep.rollout import collect
from agents.runs.tasks import make_envs
from agents.runs.train import Training

UPDATES, SEEDS = 20, (0, 1, 2)


def rollout_of(one, episodes):
    """Episodes of a policy that knows nothing, of different lengths."""
    envs = make_envs(one.task, len(SEEDS) * episodes, {})
    rng = np.random.default_rng(0)
    return collect(
        envs,
        range(len(SEEDS) * episodes),
        lambda observation: rng.uniform(-1, 1, (len(observation), 1)).astype(np.float32),
    )


def trained(name, runs, compiles):
    """The state of the first `runs` runs after some updates from the same episodes."""
    backend.configure(compiles)
    one = config(name, SEEDS[:runs])
    agent = learner(name, one.hyperparameters, one.seeds, 2, 1)
    rollout = rollout_of(one, agent.episodes).of(slice(0, runs * agent.episodes))
    for epoch in range(UPDATES):
        agent.learn(rollout, epoch, np.ones(runs, dtype=bool))
    return agent.state()


def start(name):
    one = config(name, SEEDS)
    return learner(name, one.hyperparameters, one.seeds, 2, 1).state()


def resumed_is_as_never_stopped(name):
    backend.configure(True)
    whole, stopped, resumed = (Training(config(name, SEEDS)) for _ in range(3))
    while stopped.steps.min() < 400:
        stopped.run_epoch()
    with tempfile.TemporaryDirectory() as folder:
        stopped.config.write(Path(folder))
        stopped.save(Path(folder))
        resumed.restore(Path(folder))
    assert_same(arrays_of(finished(resumed)), arrays_of(finished(whole)))


def main(names):
    found = {}
    for name in names:
        compiled, eager = trained(name, 3, True), trained(name, 3, False)
        assert compiled.keys() == eager.keys()
        parameters = [k for k in eager if k in ("actor", "critics", "multiplier.parameter")]
        found[name] = {
            "seconds of compiling": backend.CLOCK.seconds,
            "difference": {k: float(np.abs(compiled[k] - eager[k]).max()) for k in parameters},
            "moved": float(np.abs(eager["actor"] - start(name)["actor"]).max()),
        }
    name = names[0]
    of_three = trained(name, 3, True)
    assert_same(trained(name, 2, True), {k: v[:2] for k, v in of_three.items()})
    resumed_is_as_never_stopped(name)
    print(json.dumps(found))


if __name__ == "__main__":
    main(sys.argv[1:])
