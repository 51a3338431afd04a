"""What training changes in the process, and which kernel it uses where C++ is not available."""

import os
import subprocess
import sys

import pytest
import torch
from threadpoolctl import threadpool_info, threadpool_limits

import agents
from agents.lockstep import backend, kernel


def test_numpy_has_one_thread_in_training_and_the_callers_afterwards():
    """NumPy's idle threads spin: with two each, two trainings at once were nine times slower."""

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
    """A warning gives the reason, and the configuration records the backend that was used."""
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


BUILD = "from agents.lockstep import kernel; kernel.in_cpp(); print('built')"


@pytest.fixture
def compiler():
    try:
        kernel.in_cpp()
    except kernel.NoCpp as error:
        pytest.skip(str(error))


def test_processes_that_compile_at_the_same_moment_leave_one_kernel(tmp_path, compiler):
    own = os.environ | {"XDG_CACHE_HOME": str(tmp_path)}
    command = [sys.executable, "-c", BUILD]
    builds = [subprocess.Popen(command, env=own, stdout=subprocess.PIPE) for _ in range(3)]
    assert [build.communicate()[0].split() for build in builds] == 3 * [[b"built"]]
    (kept,) = (tmp_path / "circle2d-mj").iterdir()
    assert kept.suffix == ".so"


def test_a_kernel_is_built_where_no_cache_can_be_written(tmp_path, compiler, monkeypatch):
    home = tmp_path / "home"
    home.write_text("a file, so that not even root can write into it as a folder")
    monkeypatch.setenv("XDG_CACHE_HOME", str(home))
    monkeypatch.setattr(kernel.tempfile, "tempdir", str(tmp_path))
    assert kernel.error_of(kernel.in_cpp.__wrapped__()) < kernel.TOLERANCE
    assert list(tmp_path.iterdir()) == [home]


def test_a_kernel_cached_by_another_processor_is_kept_and_not_loaded(
    tmp_path, compiler, monkeypatch
):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with monkeypatch.context() as there:
        there.setattr(kernel, "_processor", lambda: b"flags: another's")
        kernel.in_cpp.__wrapped__()
    (its,) = (tmp_path / "circle2d-mj").iterdir()
    its.unlink()  # rather than overwriting the file that this process has loaded
    its.write_bytes(b"cannot be loaded here")
    assert kernel.error_of(kernel.in_cpp.__wrapped__()) < kernel.TOLERANCE
    assert its.read_bytes() == b"cannot be loaded here"
