"""The import name `safety_gymnasium`, in this process and in its child processes."""

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
"""Folder with a package of that name and the metadata of its version, for Python to find."""
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
"""Modules of safety_gymnasium, and the modules that replace them here."""


def install() -> None:
    """Let `import safety_gymnasium` find this package, here and in processes started from now on.

    Raises RuntimeError if another safety_gymnasium has already been imported.
    """
    add_to_path()
    found, here = importlib.import_module(NAME), sys.modules[FACE]
    if found is not here:
        raise RuntimeError(f"{NAME} has been imported already, from {found.__file__}")


def add_to_path() -> None:
    """Put `FOLDER` first on the import path of this process and its children."""
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
        module.__path__ = []  # makes it a package, so that `_Absent` is asked for submodules
        setattr(sys.modules[parent], leaf, module)
    if _Absent not in sys.meta_path:
        sys.meta_path.insert(0, _Absent)


class _Absent:
    """An import finder that refuses other modules of safety_gymnasium; without it Python would look
    for files of this package."""

    @staticmethod
    def find_spec(name: str, path: Any = None, target: Any = None) -> None:
        """Raise ModuleNotFoundError for a module of safety_gymnasium that is not here."""
        if name.startswith(f"{NAME}."):
            raise ModuleNotFoundError(
                f"{name} is not here: circle2d_mj has the public API of {NAME}, not its internals; "
                "to make a task of your own, use circle2d_mj.safety.own.register",
                name=name,
            )
