"""The wheel in new environments: without extras, with the drop-in, and with the lowest versions."""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
EXTRAS = PROJECT["optional-dependencies"]
PINS = ROOT / "constraints.txt"

BASE = """
import importlib.util
from pathlib import Path

for name in ("torch", "tyro", "rich", "matplotlib"):
    assert importlib.util.find_spec(name) is None, name

import agents
import circle2d_mj
import emcc
import gymnasium as gym
import mujoco
import numpy as np

env = emcc.RecordCosts(gym.make("Circle2D-1-v0", optima_perturbation=(1.0, 0.5)))
env.reset(seed=0)
assert env.step(env.action_space.sample())[4]["cost"] == 0.0
env = gym.make("Circle2DMuJoCo-0-v0", actuation="force")
env.reset(seed=0)
assert "contact_force" in env.step(env.action_space.sample())[4]
envs = gym.make_vec("circle2d_mj/SafetyPointGoal1-v0", num_envs=2)
envs.reset(seed=0)
assert envs.step(envs.action_space.sample())[4]["cost"].shape == (2,)
try:
    agents.train
except ImportError as error:
    assert str(error).startswith("agents.train needs "), error
    assert str(error).endswith("pip install -c constraints.txt '.[train]'"), error
else:
    raise AssertionError("agents.train is there")
np.save("costs.npy", np.tile([0.0, 1.0, 1.0, 0.0], (9, 1)))

package = Path(circle2d_mj.__file__).parent
assert package.is_relative_to(Path("venv").resolve()), package
mujoco.MjModel.from_xml_path(str(package / "assets" / "xml" / "circle2d.xml"))
"""


def run(folder, *command, status=0):
    """Run a command, which must end with this status."""
    env = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == status, f"{command}\n{done.stdout}\n{done.stderr}"
    return done


def install(folder, *what):
    """Make a new environment, `venv` in the folder, with these packages."""
    run(folder, sys.executable, "-m", "venv", "venv")
    pip = ("venv/bin/python", "-m", "pip", "install", "--quiet", "--no-compile")
    run(folder, *pip, *map(str, what))


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    pip = (sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps")
    run(ROOT, *pip, "--wheel-dir", str(folder), ".")
    (path,) = folder.glob("circle2d_mj-*.whl")
    return path


@pytest.mark.slow
def test_without_extras(wheel, tmp_path):
    """Environments and metric work; commands that need more say in one line what to install."""
    install(tmp_path, "-c", PINS, wheel)
    run(tmp_path, "venv/bin/python", "-c", BASE)
    assert "EMCC" in run(tmp_path, "venv/bin/python", "-m", "emcc", "costs.npy").stdout
    assert "sac-lb" in run(tmp_path, "venv/bin/saferl", "--help").stdout
    assert PROJECT["version"] in run(tmp_path, "venv/bin/circle2d", "--version").stdout
    for command in (["train", "cpo", "--out", "x"], ["report", "x"], ["resume"]):
        done = run(tmp_path, "venv/bin/circle2d", *command, status=2)
        assert done.stdout == ""
        assert re.fullmatch(
            r"circle2d: .*pip install -c constraints.txt '.\[train\]'\n", done.stderr
        )


@pytest.mark.slow
def test_the_name_safety_gymnasium(wheel, tmp_path):
    """The drop-in distribution, as programs and installers see it."""
    install(tmp_path, "-c", PINS, wheel, ROOT / "circle2d_mj" / "safety_gymnasium" / "drop_in")
    code = """
import importlib.metadata
import safety_gymnasium
from safety_gymnasium.wrappers.autoreset import SafeAutoResetWrapper
assert safety_gymnasium.__name__ == "circle2d_mj.safety_gymnasium"
assert importlib.metadata.version("safety-gymnasium") == "1.0.0"
env = safety_gymnasium.make("SafetyPointGoal1-v0")
env.reset(seed=0)
assert len(env.step(env.action_space.sample())) == 6
"""
    run(tmp_path, "venv/bin/python", "-c", code)
    assert (
        "circle2d-mj-safety-gymnasium"
        in run(tmp_path, "venv/bin/python", "-m", "pip", "list").stdout
    )


def lowest():
    """Return the lowest versions that pyproject.toml allows, as constraints; torch has the tested
    version, since any other would download gigabytes."""
    needed = [*PROJECT["dependencies"], *EXTRAS["train"], *EXTRAS["tensorboard"]]
    bounds = [re.fullmatch(r"([\w-]+)(?:\[\w+\])?>=([\d.]+)", text) for text in needed]
    pins = {bound[1]: f"{bound[1]}=={bound[2]}" for bound in bounds if bound}
    (torch,) = (line for line in PINS.read_text().splitlines() if line.startswith("torch=="))
    return pins | {"torch": torch}


@pytest.mark.slow
@pytest.mark.skipif(sys.version_info >= (3, 13), reason="numpy 2.0 has no wheel for this Python")
def test_the_lowest_versions(wheel, tmp_path, opengl):
    (tmp_path / "lowest.txt").write_text("\n".join([*lowest().values(), ""]))
    install(tmp_path, "-c", "lowest.txt", f"{wheel}[tensorboard]")
    listed = run(tmp_path, "venv/bin/python", "-m", "pip", "list", "--format", "freeze").stdout
    installed = dict(line.lower().split("==") for line in listed.split())
    for name, pin in lowest().items():
        assert f"{name}=={installed[name]}".startswith(pin)

    def circle2d(*args):
        return run(tmp_path, "venv/bin/circle2d", *args).stdout

    how = ("--backend", "numpy", "--seeds", "0", "--steps", "1.1e3")
    assert "SAC-Lag" in circle2d("train", "sac-lag", *how, "--tensorboard", "--out", "runs/sac")
    assert "CPO" in circle2d(
        "train", "cpo", *how, "--task", "Circle2DMuJoCo-1", "--out", "runs/cpo"
    )
    assert "SAC-Lag" in circle2d("report", "runs")
    circle2d("render", "runs/sac", "--out", "film.mp4", "--episodes", "1")
    (tmp_path / "scene.xml").write_text(circle2d("scene", "Circle2DMuJoCo-3-v0"))
    load = "import mujoco; mujoco.MjModel.from_xml_path('scene.xml')"
    run(tmp_path, "venv/bin/python", "-c", load)
    assert "EMCC" in run(tmp_path, "venv/bin/python", "-m", "emcc", "runs/sac").stdout
    assert (tmp_path / "film.mp4").stat().st_size > 1000


@pytest.mark.slow
@pytest.mark.parametrize("extra", sorted(EXTRAS))
def test_an_extra_can_be_resolved(extra, tmp_path):
    """With the tested versions, except tianshou, which needs older ones."""
    pins = () if extra == "tianshou" else ("-c", str(PINS))
    pip = (sys.executable, "-m", "pip", "install", "--dry-run", "--quiet", "--ignore-installed")
    run(tmp_path, *pip, *pins, f"{ROOT}[{extra}]")
