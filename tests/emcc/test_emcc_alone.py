"""emcc/pyproject.toml and emcc/README.md: the package on its own."""

import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import emcc

tomllib = pytest.importorskip("tomllib")  # Python 3.11

PACKAGE = Path(emcc.__file__).parent
ROOT = PACKAGE.parent


def test_the_pages_first_code_gives_the_numbers_beside_it():
    """The pair of the paper's first figure."""
    code = re.search(r"```python\n(.*?)```", (PACKAGE / "README.md").read_text(), re.S)
    assert code
    *setup, left, right = code[1].strip().splitlines()
    names = {}
    exec("\n".join(setup), names)
    for line in (left, right):
        expression, numbers = line.split("#")
        assert eval(expression, names) == eval(f"({numbers})")


def test_requirements_are_fewer_than_those_of_all():
    alone = tomllib.loads((PACKAGE / "pyproject.toml").read_text())["project"]
    together = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert alone["dependencies"] == ["numpy>=1.23"]
    assert alone["requires-python"] == ">=3.10"
    assert alone["version"] == together["version"]


def test_the_wheel_holds_the_package_and_works(tmp_path):
    pytest.importorskip("hatchling")
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", tmp_path],
        cwd=PACKAGE,
        check=True,
        capture_output=True,
    )
    (wheel,) = tmp_path.glob("emcc_metric-*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path / "installed")
    found = {path.name for path in (tmp_path / "installed" / "emcc").iterdir()}
    assert found == {path.name for path in PACKAGE.glob("*.py")} | {"py.typed"}
    done = subprocess.run(
        [sys.executable, "-m", "emcc", "--help"],
        cwd=tmp_path / "installed",
        capture_output=True,
        encoding="utf-8",
    )
    assert done.stdout.startswith("usage: python -m emcc")
