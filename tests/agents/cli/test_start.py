"""A quick start: what needs no torch does not import it."""

import subprocess
import sys

import pytest

HEAVY = ("torch", "tyro", "matplotlib", "rich", "mujoco", "OpenGL")


@pytest.mark.parametrize(
    ("arguments", "status"),
    [(["--help"], 0), (["trian"], 2)],
)
def test_no_heavy_import_before_a_command(arguments, status):
    code = f"""
import sys
from agents.cli.main import main
assert main({arguments}) == {status}
assert not set({HEAVY}) & set(sys.modules), sorted(set({HEAVY}) & set(sys.modules))
"""
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)


def test_importing_agents_is_light():
    code = f"import sys, agents; assert not set({HEAVY}) & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_packages_that_an_installation_may_lack():
    """Those the commands name are those of the extra [train], imageio apart, which is in the base,
    and the rest of what these bring."""
    import re
    import tomllib
    from pathlib import Path

    from agents.errors import EXTRA

    project = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text())["project"]
    names = [re.match(r"\w+", text)[0] for text in project["optional-dependencies"]["train"]]
    assert set(EXTRA) == set(names) - {"imageio"}
