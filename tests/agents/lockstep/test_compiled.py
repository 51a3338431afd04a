"""Compiled code against the same code run operation by operation."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.slow  # it compiles
HERE = Path(__file__).parent


def process(*command):
    """A process that may compile, unlike this one."""
    environment = {k: v for k, v in os.environ.items() if k != "TORCH_COMPILE_DISABLE"}
    there = (HERE.parent, HERE.parent / "algorithms")
    paths = [*map(str, there), environment.get("PYTHONPATH", "")]
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, paths))
    how = {"env": environment, "capture_output": True, "text": True, "check": False}
    return subprocess.run([sys.executable, *command], **how)


def run(*command):
    """Output of such a process. Skips where nothing can be compiled, and says why."""
    done = process(*command)
    ask = "from agents.lockstep.backend import cannot_compile; print(cannot_compile())"
    if done.returncode and (why := process("-c", ask).stdout.strip()):
        pytest.skip(why)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize(
    ("names", "median", "worst", "all_"),
    [
        (("wcsac", "sac-lb", "sac-lag pid", "cal"), 1e-5, 1e-5, 1e-5),
        (("trpo-lag", "cpo"), 2e-3, np.inf, np.inf),
        (("cup", "p3o"), 1e-4, 1e-4, np.inf),
    ],
)
def test_compiled_is_eager_but_for_rounding(names, median, worst, all_):
    """Each of 20 updates from the same state, of the trust region their median, and off-policy all
    of them together. A step of the trust region is about .1 long. Its 15 conjugate gradients
    magnify rounding, by as much as the processor's instructions differ, and the line search may
    stop elsewhere for it.
    The first of each family also: one run and two are bit for bit what they are among three, and
    one that was stopped and resumed is one that never was."""
    found = json.loads(run(str(HERE / "compiled_child.py"), *names))
    assert list(found) == list(names)
    for of_algorithm in found.values():
        assert of_algorithm["seconds of compiling"] > 0
        assert of_algorithm["moved"] > 1e-3
        assert of_algorithm["median update"] < median
        assert of_algorithm["worst update"] < worst
        assert of_algorithm["all updates"] < all_
