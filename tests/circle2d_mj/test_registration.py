"""Importing the package registers its tasks and loads no heavy library."""

import subprocess
import sys
from importlib.metadata import version

import gymnasium as gym
import pytest

from circle2d_mj.registration import CIRCLE2D, SAFETY
from circle2d_mj.safety.tasks import OLD, VISION


def run(code, folder):
    command = [sys.executable, "-W", "error", "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_the_module_prefix_of_an_id_registers_the_tasks(tmp_path):
    code = """
import gymnasium as gym
env = gym.make("circle2d_mj:Circle2D-1-v0", optima_perturbation=(1.0, 0.5))
print(env.reset(seed=0)[1]["cost"], env.unwrapped.config.optima_perturbation)
print(env.spec.max_episode_steps)
envs = gym.make_vec("Circle2D-3-v0", num_envs=1024, vectorization_mode="vector_entry_point")
print(type(envs).__name__, envs.reset(seed=0)[0].shape)
"""
    expected = ["0.0 (1.0, 0.5)", "50", "Circle2DVectorEnv (1024, 2)"]
    assert run(code, tmp_path).splitlines() == expected


def test_the_import_loads_no_heavy_library(tmp_path):
    """What is loaded on demand can be used in a process that imported only the package."""
    code = """
import sys, circle2d_mj
heavy = ("torch", "OpenGL", "mujoco", "matplotlib", "PIL", "agents", "emcc")
print([m for m in heavy if m in sys.modules])
print(circle2d_mj.__version__, circle2d_mj.Circle2DEnv.__module__)
"""
    expected = ["[]", f"{version('circle2d-mj')} circle2d_mj.circle2d.envs"]
    assert run(code, tmp_path).splitlines() == expected


def test_the_listed_ids_are_the_registered_ones():
    found = {name for name in gym.registry if name.startswith("Circle2D")}
    assert set(CIRCLE2D) == found
    assert len(CIRCLE2D) == 8
    assert {name for name in gym.registry if name.startswith("circle2d_mj/")} == {
        *SAFETY,
        *(f"circle2d_mj/{name}" for name in (*OLD, *VISION)),
    }


def test_an_unknown_keyword_has_pythons_error_message():
    """TorchRL looks for this message, and then makes the environment without `frameskip`."""
    words = "got an unexpected keyword argument 'frameskip'"
    for name in (CIRCLE2D[0], CIRCLE2D[4], SAFETY[0]):
        with pytest.raises(TypeError, match=words):
            gym.make(name, frameskip=1)
        with pytest.raises(TypeError, match=words):
            gym.make_vec(name, 2, vectorization_mode="vector_entry_point", frameskip=1)
