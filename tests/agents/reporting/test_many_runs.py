"""A report on very many runs: its time, its memory and its page."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from agents.paper.grid import grid, prepare
from agents.training.trainer import train

FOLDERS = 150
MEASURED = """
import sys, time
from pathlib import Path
import jinja2, matplotlib.figure, pandas, scipy.stats, torch  # of very different size by build

def mebibytes(name):  # not of getrusage, which counts what the parent had before exec
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith(name))

before = mebibytes("VmHWM")
from agents.reporting.report import report
report(Path(sys.argv[1]))
print(time.process_time(), mebibytes("VmHWM") - before)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="memory is read from /proc")
def test_150_folders_of_two_runs(tmp_path):
    """Five algorithms on two tasks, each fifteen times with another cost limit.

    Measured: 21 s of CPU, and 122 MiB above what importing the libraries takes.
    """
    tasks = ["Circle2D-1-v0", "Circle2DMuJoCo-0-v0"]
    names = ["trpo-lag", "cpo", "sac-lag", "sac-lb", "wcsac"]
    configs = grid(tmp_path / "few", tasks, names, (0, 1), 1500)
    prepare(configs)
    for k, folder in enumerate(configs):
        train(folder)
        content = json.loads((folder / "config.json").read_text())
        for copy in range(FOLDERS // len(configs)):
            to = tmp_path / "many" / f"{k}-{copy}"
            shutil.copytree(folder, to)
            content["hyperparameters"]["cost_limit"] = 5.0 + copy
            (to / "config.json").write_text(json.dumps(content))
    root = Path(__file__).parents[3]
    environment = os.environ | {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(root)}
    done = subprocess.run(
        [sys.executable, "-c", MEASURED, str(tmp_path / "many")],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    seconds, mebibytes = map(float, done.stdout.split())
    page = (tmp_path / "many" / "index.html").stat().st_size / 1e6
    assert seconds < 60, done.stdout
    assert mebibytes < 150, done.stdout
    assert page < 6
