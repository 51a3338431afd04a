"""Compiled code against the same code run operation by operation."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent


def run(*command):
    """What a process prints that may compile, unlike this one."""
    environment = {k: v for k, v in os.environ.items() if k != "TORCH_COMPILE_DISABLE"}
    paths = [str(HERE), environment.get("PYTHONPATH", "")]
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, paths))
    done = subprocess.run(
        [sys.executable, *command], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def compiler():
    """Skips where nothing can be compiled, and says why."""
    ask = "from agents.lockstep.backend import cannot_compile; print(cannot_compile())"
    if why := run("-c", ask).strip():
        pytest.skip(why)


@pytest.mark.parametrize("names", [("sac-lag", "sac-lb", "wcsac"), ("trpo-lag", "cpo")])
def test_compiled_is_eager_but_for_rounding(names, compiler):
    """After 20 updates from the same episodes. The first of each family also: runs among two are
    bit for bit those among three, and a run that was stopped and resumed is one that never was."""
    found = json.loads(run(str(HERE / "compiled_child.py"), *names))
    assert list(found) == list(names)
    for of_algorithm in found.values():
        assert of_algorithm["seconds of compiling"] > 0
        assert of_algorithm["moved"] > 1e-3
        assert len(of_algorithm["difference"]) >= 2
        assert max(of_algorithm["difference"].values()) < 1e-5
