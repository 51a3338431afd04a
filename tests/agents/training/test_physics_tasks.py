"""All five algorithms on Circle2D with MuJoCo's physics, by the command line and resumed."""

from dataclasses import replace

import numpy as np
import pytest
from agents.training.loop import Training, train

from agents.algorithms import algorithm
from agents.paper.presets import PAPER_ALGORITHMS, preset
from agents.sac import OffPolicy
from agents.training.config import TrainConfig
from agents.training.files import read_arrays

TASKS = ("Circle2DMuJoCo-0-v0", "Circle2DMuJoCo-1-v0")


def config(name, task, seeds=(0, 1)):
    hyperparameters = preset(name, task)
    assert hyperparameters.cost_limit == 5.0  # the paper's, as in the kinematic mode
    if algorithm(name).family is OffPolicy:
        hyperparameters = replace(hyperparameters, random_steps=100, gradient_steps=2)
    else:
        hyperparameters = replace(hyperparameters, episodes=3)
    parameters = {"actuation": "force"} if task.endswith("0-v0") else {}
    return TrainConfig(name, task, seeds, 450, hyperparameters, parameters, 150)


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("name", PAPER_ALGORITHMS)
def test_trains_resumes_and_is_independent_of_its_company(name, task, tmp_path):
    folders = {key: tmp_path / key for key in ("whole", "stopped", "alone")}
    for key, folder in folders.items():
        config(name, task, (1,) if key == "alone" else (0, 1)).write(folder)
    stopped = Training(config(name, task))
    while stopped.steps.max() < 150:
        stopped.run_epoch()
    stopped.save(folders["stopped"])
    stopped.close()
    for folder in folders.values():
        train(folder)
    arrays = {key: read_arrays(folder / "checkpoint.npz") for key, folder in folders.items()}
    for array, value in arrays["whole"].items():
        assert np.isfinite(value).all() or array.startswith("log.")
        np.testing.assert_array_equal(value, arrays["stopped"][array])
    for file in ("episodes.csv", "updates.csv", "evaluation.json", "visited.npy", "costs.npy"):
        files = {(folder / "seed-1" / file).read_bytes() for folder in folders.values()}
        assert len(files) == 1, file
