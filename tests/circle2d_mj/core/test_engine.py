"""MuJoCo as the package imports it."""

import subprocess
import sys

import pytest

DURATION = """
import time
import mujoco
{before}
from circle2d_mj.core import engine
{after}
model = mujoco.MjModel.from_xml_string("<mujoco/>")
data = mujoco.MjData(model)
mujoco.mj_step(model, data)
print(data.timer[mujoco.mjtTimer.mjTIMER_STEP].duration > 0)
"""
OWN = "mujoco.set_mjcb_time(time.perf_counter)"


@pytest.mark.parametrize(
    ("before", "after", "measured"),
    [
        ("", "", False),
        ("", "mujoco.set_mjcb_time(None)", True),
        ("", OWN, True),
        (OWN, "", True),
    ],
)
def test_mujocos_profiler_runs_only_where_it_is_switched_on(before, after, measured):
    code = DURATION.format(before=before, after=after)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == str(measured)
