"""The examples run and print a panel."""

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import pytest

from agents.presets import preset, preset_with

FOLDER = Path(__file__).parents[1] / "examples"
NEEDED = {
    "with_gymnasium.py": ("gymnasium",),
    "with_minari.py": ("minari", "jax", "h5py"),
    "with_mlflow.py": ("mlflow",),
    "with_optuna.py": ("optuna",),
    "with_ray_tune.py": ("ray", "pyarrow"),
    "with_sb3.py": ("stable_baselines3",),
    "with_sb3_streaks.py": ("stable_baselines3",),
    "with_tianshou.py": ("tianshou",),
    "with_torchrl.py": ("torchrl",),
    "with_wandb.py": ("wandb",),
}
"""Libraries that each example needs."""


def test_every_example_is_listed():
    assert {path.name for path in FOLDER.glob("with_*.py")} == set(NEEDED)


@pytest.mark.parametrize("name", NEEDED)
def test_an_example_runs(name, tmp_path):
    for module in NEEDED[name]:
        if importlib.util.find_spec(module) is None:
            pytest.skip(f"needs {module}")
    here = os.pathsep.join(filter(None, [str(FOLDER.parent), os.environ.get("PYTHONPATH")]))
    env = {"PYTHONPATH": here, "MINARI_DATASETS_PATH": str(tmp_path), "OMP_NUM_THREADS": "1"}
    env |= {"RAY_ADDRESS": "local"}  # not a cluster that another program left behind
    how = {"cwd": tmp_path, "env": os.environ | env, "timeout": 600, "encoding": "utf-8"}
    done = subprocess.run([sys.executable, FOLDER / name], capture_output=True, **how)
    assert done.returncode == 0, done.stderr
    assert "violation rate V" in done.stdout
    assert "limit 5" in done.stdout


def test_a_thicker_wall(monkeypatch):
    """The wall between cut-outs and corridor is 2.5 + 1.1 thick; SAC-LB keeps its preset."""
    monkeypatch.syspath_prepend(FOLDER)
    importlib.import_module("thick_wall")
    name = "Circle2DThickWall-3-v0"
    for env in (gym.make(name), gym.make_vec(name, 2)):
        region = env.unwrapped.config.region
        assert region.crossing() == pytest.approx(3.6)
        # In the top cut-out below its new end and above it; in the corridor; in the middle.
        points = [(0, 6.0), (0, 6.2), (-5, 0), (0, 0)]
        assert region.contains(points).tolist() == [True, False, False, True]
    changes = {"cost_limit": 5.0, "time_limit": "terminal"}
    assert preset_with("sac-lb", name, changes) == preset("sac-lb", "Circle2D-3-v0")
    del gym.registry[name]


def test_a_task_from_the_suites_parts(monkeypatch):
    """It has a penalty for each step, a native vector environment and a view of distances."""
    monkeypatch.syspath_prepend(FOLDER)
    importlib.import_module("my_suite_task")
    name = "SafetyCarGauntlet-v0"
    one, many = gym.make(name), gym.make_vec(name, 2)
    observation, _ = one.reset(seed=1)
    assert (many.reset(seed=0)[0][1] == observation).all()
    task = one.unwrapped.task
    before, reward = task.dist_goal(), one.step([0.1, 0.1])[1]
    assert reward == pytest.approx(before - task.dist_goal() - 0.001)
    assert (task.hazards.num, task.gremlins.num, one.spec.max_episode_steps) == (5, 2, 400)
    assert many.view.axes == ("to the goal (m)", "to the nearest hazard (m)")
    for id in (name, f"circle2d_mj/{name}"):
        del gym.registry[id]


@pytest.mark.parametrize("path", sorted(FOLDER.glob("slurm/*.sbatch")), ids=lambda path: path.name)
def test_batch_scripts_have_no_findings_of_shellcheck(path):
    subprocess.run(["bash", "-n", path], check=True)
    where = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    shellcheck = shutil.which("shellcheck", path=where)
    if shellcheck is None:
        pytest.skip("needs shellcheck")
    subprocess.run([shellcheck, path], check=True)
