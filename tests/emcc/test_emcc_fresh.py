"""The wheel of emcc alone, with its tests, in environments of other Pythons and versions."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
OLD_STACK = ("numpy==1.23.5", "gymnasium==0.28.1")
"""Where OmniSafe's users are."""
ENVIRONMENTS = {
    "3.10, old stack": ("3.10", OLD_STACK),
    "3.11, numpy alone": ("3.11", ("numpy",)),
    "3.13, with gymnasium": ("3.13", ("[gymnasium]",)),
}
COSTS_OF_ENVIRONMENTS = """
import gymnasium as gym
import numpy as np
from scripted import Scripted

import emcc

SCRIPT = [[0.0, 0.0, 1.0, 1.0]]
env = emcc.RecordCosts(Scripted(SCRIPT))
for _ in range(3):
    env.reset(seed=0)
    for _ in range(4):
        env.step(0)
assert env.records.longest_streak.tolist() == [2, 2, 2], env.records
assert env.records.emcc() == 0.5
if gym.__version__.split(".")[0] == "0":
    envs = emcc.RecordCosts(gym.vector.SyncVectorEnv([lambda: Scripted(SCRIPT)] * 2))
    envs.reset(seed=0)
    for _ in range(8):
        envs.step(np.zeros(2, int))
    assert envs.records.cost.tolist() == [2.0] * 4, envs.records
print(emcc.panel(env.records, limit=1.0).to_markdown())
"""


def interpreter(version):
    """The path of a Python of this version; None without one."""
    code = "import sys; print(sys.executable, *sys.version_info[:2], sep='\\n')"
    for command in (sys.executable, f"python{version}"):
        try:
            # pyenv's shims run the version that is named so.
            env = os.environ | {"PYENV_VERSION": version}
            how = {"env": env, "capture_output": True, "text": True}
            done = subprocess.run([command, "-c", code], **how)
        except OSError:
            continue
        if done.returncode == 0 and ".".join(done.stdout.split("\n")[1:3]) == version:
            return done.stdout.split("\n")[0]
    return None


def run(folder, *command):
    env = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True)
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    source = TESTS.parents[1] / "emcc"
    pip = (sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps")
    run(folder, *pip, "--wheel-dir", str(folder), str(source))
    (path,) = folder.glob("emcc_metric-*.whl")
    return path


@pytest.mark.slow
@pytest.mark.parametrize(("version", "packages"), ENVIRONMENTS.values(), ids=ENVIRONMENTS)
def test_alone(wheel, tmp_path, version, packages):
    python = interpreter(version)
    if python is None:
        pytest.skip(f"there is no Python {version}")
    extras = "".join(name for name in packages if name.startswith("["))
    others = [name for name in packages if not name.startswith("[")]
    run(tmp_path, python, "-m", "venv", "venv")
    install = ("-m", "pip", "install", "--quiet", f"{wheel}{extras}", *others)
    run(tmp_path, "venv/bin/python", *install, "pytest", "hypothesis")
    shutil.copytree(TESTS, tmp_path / "tests")
    shutil.copy(TESTS.parent / "conftest.py", tmp_path / "tests")
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = slow\npythonpath = tests\n")
    without = [f"--ignore=tests/test_emcc_{name}.py" for name in ("alone", "fresh")]
    pytest_ = ("-m", "pytest", "-q", "--import-mode=importlib", "-p", "no:cacheprovider")
    report = run(tmp_path, "venv/bin/python", *pytest_, "tests", *without)
    assert " passed" in report
    run(tmp_path, "venv/bin/python", "-m", "emcc", "--help")
    if any("gymnasium" in name for name in packages):
        python = str(tmp_path / "venv/bin/python")
        table = run(tmp_path / "tests", python, "-c", COSTS_OF_ENVIRONMENTS)
        assert "violation rate V" in table
