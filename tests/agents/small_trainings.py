"""Trainings of a few epochs in memory, which tests can stop and inspect after each epoch."""

import dataclasses
import tempfile
from pathlib import Path

import numpy as np

from agents.algorithms import algorithm
from agents.lockstep import tree
from agents.training.config import TrainConfig
from agents.training.trainer import Trainer

SMALL = {"cost_limit": 1.0, "batch_size": 32, "hidden": (32, 32), "episodes": 3}
SMALL |= {"random_steps": 50, "gradient_steps": 2, "actor_iterations": 2, "critic_iterations": 2}
SMALL |= {"cg_iterations": 5, "line_search_steps": 5, "limit_of": "discounted"}
SMALL |= {"saute_discount": 1.0}  # tasks of toys have no time limit


def small(name, **changes):
    """Return an algorithm's config with small values; settings that it lacks are ignored."""
    known = {field.name for field in dataclasses.fields(algorithm(name).config)}
    return algorithm(name).config(**{k: v for k, v in (SMALL | changes).items() if k in known})


def trainer(config, folder=None):
    """Return a trainer before its first epoch; without a folder it cannot save."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = folder or Path(temporary) / "run"
        if not (folder / "config.json").exists():
            config.write(folder)
        return Trainer(folder, config)


def trained(name, task="Walk-v0", seeds=(0, 1), steps=600, parameters=None, **changes):
    """Return the finished training of some runs, in memory."""
    config = TrainConfig(name, (task,), seeds, steps, small(name, **changes), parameters or {})
    return finished(trainer(config))


def finished(it):
    """Train to the end and return the trainer."""
    while not it.done:
        it.run_epoch()
    return it


def of_run(it, run):
    """Return a run's parameters and what it recorded since the last save."""
    state = {k: v[run] for k, v in tree.flatten(it.learner._state).items()}
    prefix = it.config.runs[run].prefix
    rows = {k: np.concatenate(v) for k, v in it.recorder._new.items() if k.startswith(prefix)}
    return state | {k.removeprefix(prefix): v for k, v in rows.items()}


def assert_same(a, b):
    """Assert that both have the same names, and arrays that are equal bit for bit."""
    assert a.keys() == b.keys()
    for name, value in a.items():
        np.testing.assert_array_equal(value, b[name], err_msg=name)
