"""All five algorithms on Circle2D with MuJoCo's physics, and on a Safety task, resumed."""

import numpy as np
import pytest
from small_runs import SAC, TRPO, differing, results, run_of

import agents
from agents.algorithms import algorithm
from agents.sac import OffPolicy
from agents.training.config import RunId

POINT = "circle2d_mj/SafetyPointCircle1-v0"
TASKS = {"Circle2DMuJoCo-0-v0": {"actuation": "force"}, "Circle2DMuJoCo-1-v0": {}}


SLOW = pytest.param("Circle2DMuJoCo-1-v0", marks=pytest.mark.slow)


@pytest.mark.parametrize("task", ["Circle2DMuJoCo-0-v0", SLOW])
@pytest.mark.parametrize("name", ["cpo", "sac-lb"])
def test_trains_resumes_and_is_independent_of_its_company(name, task, tmp_path):
    more = SAC if algorithm(name).family is OffPolicy else TRPO
    more = more | {"steps": 300, "checkpoint_every": 150, "task_parameters": TASKS[task]}
    whole = agents.train(name, task, seeds=(0, 1), out=tmp_path / "whole", **more)
    assert whole.config.hyperparameters.cost_limit == 5.0  # the paper's, as without physics
    part = tmp_path / "part"
    stop = {"on_epoch": lambda epoch: epoch.runs[0]["step"] < 150}
    agents.train(name, task, seeds=(0, 1), out=part, **more, **stop)
    agents.resume(part)
    assert results(part) == results(whole.folder)
    alone = agents.train(name, task, seeds=1, out=tmp_path / "alone", **more)
    run = RunId(task, 1)
    assert not differing(run_of(whole.folder, run), run_of(alone.folder, run))


def test_a_safety_task_records_where_the_point_is(tmp_path):
    """It starts within 0.4 m of the middle, and moves a few centimetres a step."""
    more = TRPO | {"seeds": 3, "steps": 50, "task_parameters": {"max_episode_steps": 20}}
    runs = agents.train("trpo-lag", POINT, out=tmp_path / "x", **more)
    [file] = (runs.folder / "steps").iterdir()
    positions = np.load(file)["circle2d_mj-SafetyPointCircle1-v0/3/positions"]
    assert np.abs(positions[::20]).max() < 1.0
    assert 0 < np.abs(np.diff(positions[:20], axis=0)).max() < 0.1
