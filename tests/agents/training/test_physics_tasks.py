"""All five algorithms on Circle2D with MuJoCo's physics, and on a Safety task, resumed."""

import pytest
from small_runs import differing, run_of

import agents
from agents.algorithms import algorithm
from agents.paper.presets import PAPER_ALGORITHMS
from agents.sac import OffPolicy
from agents.training.config import TrainConfig
from agents.training.trainer import train

POINT = "circle2d_mj/SafetyPointCircle1-v0"
TASKS = {"Circle2DMuJoCo-0-v0": {"actuation": "force"}, "Circle2DMuJoCo-1-v0": {}}


def config(name, task, seeds=(0, 1)):
    hyperparameters = preset(name, task)
    assert hyperparameters.cost_limit == 5.0  # the paper's, as in the kinematic mode
    if algorithm(name).family is OffPolicy:
        hyperparameters = replace(hyperparameters, random_steps=100, gradient_steps=2)
    else:
        hyperparameters = replace(hyperparameters, episodes=3)
    parameters = {"actuation": "force"} if task.endswith("0-v0") else {}
    return TrainConfig(name, (task,), seeds, 450, hyperparameters, parameters)


@pytest.mark.parametrize("task", ["Circle2DMuJoCo-0-v0", SLOW])
@pytest.mark.parametrize("name", PAPER_ALGORITHMS)
def test_trains_resumes_and_is_independent_of_its_company(name, task, tmp_path):
    folders = {key: tmp_path / key for key in ("whole", "stopped", "alone")}
    for key, folder in folders.items():
        config(name, task, (1,) if key == "alone" else (0, 1)).write(folder)
    assert train(folders["stopped"], lambda it: bool(it.steps.max() < 150)).stopped
    for folder in folders.values():
        assert (train(folder).failures == "").all()
    run = config(name, task).runs[1]
    whole, stopped, alone = (run_of(folder, run) for folder in folders.values())
    assert not differing(whole, stopped)
    assert not differing(whole, alone)
    assert {"evaluation/deterministic/returns", "replay/points"} < whole.keys()
