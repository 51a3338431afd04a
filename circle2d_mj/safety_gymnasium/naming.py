"""The name `safety_gymnasium`, in this process and in those that it starts."""

from __future__ import annotations

import importlib
import os
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

from circle2d_mj.safety import layout
from circle2d_mj.safety_gymnasium import making, vector, wrappers

NAME, FACE = "safety_gymnasium", "circle2d_mj.safety_gymnasium"
FOLDER = Path(__file__).parent / "drop_in"
"""Holds a package of that name, and what tells its version, for Python to find"""
_OF_WRAPPERS = ("autoreset", "env_checker", "normalize", "rescale_action", "time_limit")
_MULTI_AGENT = "tasks.safe_multi_agent"
MODULES: dict[str, ModuleType] = {
    "wrappers": wrappers,
    **{f"wrappers.{module}": wrappers for module in (*_OF_WRAPPERS, "unsqueeze")},
    "wrappers.gymnasium_conversion": making,
    "vector": vector,
    **{f"vector.{module}": vector for module in ("async_vector_env", "sync_vector_env", "utils")},
    "vector.utils.tile_images": vector,
    "utils": making,
    "utils.registration": making,
    "utils.common_utils": layout,
    "tasks": making,
    _MULTI_AGENT: making,
    f"{_MULTI_AGENT}.safe_mujoco_multi": making,
    f"{_MULTI_AGENT}.tasks": making,
    f"{_MULTI_AGENT}.tasks.velocity": making,
    f"{_MULTI_AGENT}.tasks.velocity.safe_mujoco_multi": making,
}
"""Modules of safety_gymnasium, and what takes their places here"""


def install() -> None:
    """Let `import safety_gymnasium` find this package, here and in processes started from now on.

    Raises RuntimeError where another safety_gymnasium has been imported.
    """
    add_to_path()
    found, here = importlib.import_module(NAME), sys.modules[FACE]
    if found is not here:
        raise RuntimeError(f"{NAME} has been imported already, from {found.__file__}")


def add_to_path() -> None:
    """Put the folder that holds the name first, in this process and in its children."""
    folder = str(FOLDER)
    if folder not in sys.path:
        sys.path.insert(0, folder)
    others = [path for path in os.environ.get("PYTHONPATH", "").split(os.pathsep) if path]
    if folder not in others:
        os.environ["PYTHONPATH"] = os.pathsep.join([folder, *others])


def take_the_name() -> None:
    """Put this package and its parts into `sys.modules` under safety_gymnasium's names."""
    here: Any = importlib.import_module(FACE)
    sys.modules[NAME] = sys.modules[f"{NAME}.version"] = here
    for name, module in MODULES.items():
        parent, _, leaf = f"{NAME}.{name}".rpartition(".")
        sys.modules[f"{NAME}.{name}"] = module
        module.__path__ = []  # for Python a package: it asks `_Absent` for what is not in there
        setattr(sys.modules[parent], leaf, module)
    if _Absent not in sys.meta_path:
        sys.meta_path.insert(0, _Absent)


class _Absent:
    """Says that a module of safety_gymnasium is not here; Python would look for a file of ours."""

    @staticmethod
    def find_spec(name: str, path: Any = None, target: Any = None) -> None:
        """Raise ModuleNotFoundError for such a module."""
        if name.startswith(f"{NAME}."):
            raise ModuleNotFoundError(
                f"{name} is not here: circle2d_mj has the face of {NAME}, not what is inside; a "
                "task of your own is made by circle2d_mj.safety.own.register",
                name=name,
            )
