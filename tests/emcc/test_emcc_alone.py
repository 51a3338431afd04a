"""The package on its own: `import emcc` needs numpy alone; emcc/pyproject.toml builds it."""

import ast
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

import emcc

PACKAGE = Path(emcc.__file__).parent


def python(*arguments, cwd=PACKAGE.parent):
    return subprocess.run([sys.executable, *arguments], cwd=cwd, capture_output=True, text=True)


def test_import_loads_numpy_alone():
    code = (
        "import sys, numpy.random; before = set(sys.modules); import emcc; import emcc.__main__;"
        "new = {m.partition('.')[0] for m in set(sys.modules) - before};"
        "print(sorted(new - set(sys.stdlib_module_names) - {'emcc', 'numpy'}))"
    )
    done = python("-c", code)
    assert (done.stdout, done.stderr) == ("[]\n", "")


MISSING = {"RecordCosts": "gymnasium", "StreakCost": "gymnasium", "sb3": "stable-baselines3"}


@pytest.mark.parametrize(("name", "library"), MISSING.items())
def test_a_missing_library_is_named(name, library, monkeypatch):
    module = library.replace("-", "_")
    for loaded in [m for m in sys.modules if m.startswith(("emcc", module))]:
        monkeypatch.delitem(sys.modules, loaded)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ImportError, match=f"pip install .*{library}"):
        getattr(__import__("emcc"), name)


def test_every_public_name_is_there_and_no_other():
    pytest.importorskip("gymnasium", minversion="1.1")
    functions = {name for name in set(emcc.__all__) - {"sb3"} if callable(getattr(emcc, name))}
    assert not functions & {path.stem for path in PACKAGE.glob("*.py")}
    with pytest.raises(AttributeError, match="nothing"):
        emcc.nothing  # noqa: B018  # pyright: ignore[reportAttributeAccessIssue]


def test_the_source_is_of_python_3_10():
    for path in PACKAGE.glob("*.py"):
        ast.parse(path.read_text(), feature_version=(3, 10))


def test_the_wheel_holds_the_package_and_works(tmp_path):
    pytest.importorskip("hatchling")
    tomllib = pytest.importorskip("tomllib")  # Python 3.11
    files = [folder / "pyproject.toml" for folder in (PACKAGE, PACKAGE.parent)]
    alone, together = (tomllib.loads(file.read_text())["project"] for file in files)
    assert alone["version"] == together["version"]
    done = python("-m", "hatchling", "build", "-t", "wheel", "-d", tmp_path, cwd=PACKAGE)
    assert done.returncode == 0, done.stderr
    (wheel,) = tmp_path.glob("emcc_metric-*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path / "installed")
    found = {path.name for path in (tmp_path / "installed" / "emcc").iterdir()}
    assert found == {path.name for path in PACKAGE.glob("*.py")} | {"py.typed"}
    done = python("-m", "emcc", "--help", cwd=tmp_path / "installed")
    assert done.stdout.startswith("usage: python -m emcc")


def test_pandas_like_objects_are_arrays():
    class Series:
        def __array__(self, dtype=None, copy=None):
            return np.array([0.0, 1.0, 1.0], dtype=dtype)

    assert emcc.longest_streak(Series()) == 2
