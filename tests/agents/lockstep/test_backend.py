"""What training changes in the process, and the kernels it may take."""

import os
import subprocess
import sys

import pytest
import torch
from threadpoolctl import threadpool_info, threadpool_limits

import agents
from agents.lockstep import backend, kernel


def test_numpy_has_one_thread_in_training_and_the_callers_afterwards():
    """Its idle threads spin: two trainings side by side were nine times slower with two each."""

    def of_numpy():
        return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}

    seen = []
    with threadpool_limits(3, user_api="blas"):
        arguments = {"seeds": 0, "steps": 200, "episodes": 2, "backend": "numpy"}
        agents.train("trpo-lag", **arguments, on_epoch=lambda _: seen.append(of_numpy()))
        assert of_numpy() == {3}
    assert seen == [{1}, {1}]


def test_the_callers_threads_and_kernel_come_back():
    threads, used = torch.get_num_threads(), kernel.used()
    with backend.restored():
        backend.configure("numpy" if used == "c++" else "c++")
        assert kernel.used() != used
    assert (torch.get_num_threads(), kernel.used()) == (threads, used)


TRAIN = """
import sys, agents
runs = agents.train("ppo-lag", "Circle2D-1-v0", seeds=0, steps=500, out=sys.argv[1])
print(runs.config.backend)
"""


@pytest.mark.parametrize(
    ("compiler", "reason"),
    [("/nowhere/c++", "No such file"), ("false", "Command"), ("true", "No such file")],
)
def test_without_a_compiler_training_goes_on_in_numpy(tmp_path, compiler, reason):
    """Named in a warning; where C++ is asked for, the training is still done, and its file says
    by what."""
    own = os.environ | {
        "CXX": compiler,
        "XDG_CACHE_HOME": str(tmp_path),
        "PYTHONWARNINGS": "always",
    }
    command = [sys.executable, "-c", TRAIN, str(tmp_path / "runs")]
    done = subprocess.run(command, env=own, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["numpy"]
    assert "networks are computed in NumPy" in done.stderr
    assert reason in done.stderr
    assert agents.load_policy(tmp_path / "runs").step == 500
