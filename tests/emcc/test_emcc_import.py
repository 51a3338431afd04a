"""`import emcc` needs numpy alone."""

import ast
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import emcc

PACKAGE = Path(emcc.__file__).parent


def test_import_loads_numpy_alone():
    outsiders = "gymnasium torch pandas matplotlib scipy mujoco circle2d_mj agents"
    code = (
        "import sys, numpy.random; before = set(sys.modules); import emcc; import emcc.__main__;"
        "new = {m.partition('.')[0] for m in set(sys.modules) - before};"
        "new = new - set(sys.stdlib_module_names) - {'emcc', 'numpy'};"
        f"assert not new & set('{outsiders}'.split()), new;"
        "print(sorted(new))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=PACKAGE.parent, capture_output=True, text=True
    )
    assert (done.stdout, done.stderr) == ("[]\n", "")


@pytest.mark.parametrize(
    ("module", "name", "advice"),
    [
        ("gymnasium", "RecordCosts", "pip install 'gymnasium>=0.28'"),
        ("gymnasium", "StreakCost", "pip install 'gymnasium>=1.1'"),
        ("stable_baselines3", "sb3", "pip install stable-baselines3"),
    ],
)
def test_a_missing_library_is_named(module, name, advice):
    code = f"import sys; sys.modules[{module!r}] = None; import emcc; emcc.{name}"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=PACKAGE.parent, capture_output=True, text=True
    )
    assert done.stderr.splitlines()[-1].startswith("ImportError: emcc.")
    assert advice in done.stderr.splitlines()[-1]


def test_no_submodule_has_the_name_of_a_public_function():
    pytest.importorskip("gymnasium", minversion="1.1")
    modules = {path.stem for path in PACKAGE.glob("*.py")}
    functions = {name for name in set(emcc.__all__) - {"sb3"} if callable(getattr(emcc, name))}
    assert not modules & functions


def test_the_source_is_of_python_3_10():
    for path in PACKAGE.glob("*.py"):
        ast.parse(path.read_text(), feature_version=(3, 10))
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        emcc.nothing  # noqa: B018  # pyright: ignore[reportAttributeAccessIssue]


def test_pandas_like_objects_are_arrays():
    class Series:
        def __array__(self, dtype=None, copy=None):
            return np.array([0.0, 1.0, 1.0], dtype=dtype)

    assert emcc.longest_streak(Series()) == 2
