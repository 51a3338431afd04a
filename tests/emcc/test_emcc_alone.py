"""The package emcc by itself: importing it needs only NumPy, and its wheel passes these tests in
environments with other versions of Python and of its dependencies."""

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import emcc

PACKAGE = Path(emcc.__file__).parent


def test_the_import_loads_only_numpy():
    code = (
        "import sys, numpy.random; before = set(sys.modules); import emcc; import emcc.__main__;"
        "new = {m.partition('.')[0] for m in set(sys.modules) - before};"
        "print(sorted(new - set(sys.stdlib_module_names) - {'emcc', 'numpy'}))"
    )
    assert run(PACKAGE.parent, sys.executable, "-c", code) == "[]\n"


MISSING = {"RecordCosts": "gymnasium", "StreakCost": "gymnasium", "sb3": "stable-baselines3"}


@pytest.mark.parametrize(("name", "library"), MISSING.items())
def test_a_missing_library_is_named(name, library, monkeypatch):
    module = library.replace("-", "_")
    for loaded in [m for m in sys.modules if m.startswith(("emcc", module))]:
        monkeypatch.delitem(sys.modules, loaded)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ImportError, match=f"pip install .*{library}"):
        getattr(__import__("emcc"), name)


def test_every_public_name_exists_and_no_function_is_named_like_a_module():
    pytest.importorskip("gymnasium", minversion="1.1")
    functions = {name for name in set(emcc.__all__) - {"sb3"} if callable(getattr(emcc, name))}
    assert not functions & {path.stem for path in PACKAGE.glob("*.py")}
    with pytest.raises(AttributeError, match="nothing"):
        emcc.nothing  # noqa: B018  # pyright: ignore[reportAttributeAccessIssue]


TESTS = Path(__file__).parent
OLD_STACK = ("numpy==1.23.5", "gymnasium==0.28.1")
"""Versions that users of OmniSafe have."""
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

makers = [lambda: Scripted([[0.0, 0.0, 1.0, 1.0]])] * 2
env, envs = emcc.RecordCosts(makers[0]()), emcc.RecordCosts(gym.vector.SyncVectorEnv(makers))
for _ in range(3):
    env.reset(seed=0)
    for _ in range(4):
        env.step(0)
assert env.records.longest_streak.tolist() == [2, 2, 2], env.records
envs.reset(seed=0)
for _ in range(8):
    envs.step(np.zeros(2, int))
assert envs.records.cost.tolist() == [2.0] * 4, envs.records
print(emcc.panel(env.records, limit=1.0).to_markdown())
"""
"""For the old stack, with whose gymnasium the tests of the wrappers are skipped."""


def interpreter(version):
    """Return the path of a Python of this version, or None. pyenv's shims need PYENV_VERSION."""
    code, env = "import sys; print(sys.executable)", os.environ | {"PYENV_VERSION": version}
    command = shutil.which(f"python{version}")
    how = {"env": env, "capture_output": True, "text": True}
    done = command and subprocess.run([command, "-c", code], **how)
    return done.stdout.strip() if done and done.returncode == 0 else None


def run(folder, *command):
    """Run a command, which must succeed, and return its output."""
    env = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True)
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    pip = (sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps")
    run(folder, *pip, "--wheel-dir", str(folder), str(PACKAGE))
    (path,) = folder.glob("emcc_metric-*.whl")
    return path


@pytest.mark.slow
def test_the_wheel_holds_the_package(wheel):
    tomllib = pytest.importorskip("tomllib")  # Python 3.11
    files = [folder / "pyproject.toml" for folder in (PACKAGE, PACKAGE.parent)]
    alone, together = (tomllib.loads(file.read_text())["project"] for file in files)
    assert alone["version"] == together["version"]
    with zipfile.ZipFile(wheel) as archive:
        found = {name for name in archive.namelist() if name.startswith("emcc/")}
    assert found == {f"emcc/{path.name}" for path in PACKAGE.glob("*.py")} | {"emcc/py.typed"}


@pytest.mark.slow
@pytest.mark.parametrize(("version", "packages"), ENVIRONMENTS.values(), ids=ENVIRONMENTS)
def test_the_tests_pass_with_the_wheel_alone(wheel, tmp_path, version, packages):
    python = interpreter(version)
    if python is None:
        pytest.skip(f"there is no Python {version}")
    extras = "".join(name for name in packages if name.startswith("["))
    others = [name for name in packages if not name.startswith("[")]
    run(tmp_path, python, "-m", "venv", "venv")
    install = ("-m", "pip", "install", "--quiet", "--no-compile", f"{wheel}{extras}", *others)
    run(tmp_path, "venv/bin/python", *install, "pytest", "hypothesis")
    shutil.copytree(TESTS, tmp_path / "tests")
    shutil.copy(TESTS.parent / "conftest.py", tmp_path / "tests")
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = slow\npythonpath = tests\n")
    pytest_ = ("-m", "pytest", "-q", "--import-mode=importlib", "-p", "no:cacheprovider")
    report = run(
        tmp_path, "venv/bin/python", *pytest_, "tests", "--ignore=tests/test_emcc_alone.py"
    )
    assert " passed" in report
    run(tmp_path, "venv/bin/python", "-m", "emcc", "--help")
    if packages is OLD_STACK:
        python = str(tmp_path / "venv/bin/python")
        table = run(tmp_path / "tests", python, "-c", COSTS_OF_ENVIRONMENTS)
        assert "violation rate V" in table
