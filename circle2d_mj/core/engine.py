"""MuJoCo, imported for simulation.

MuJoCo chooses its OpenGL backend on import, and the import fails if MUJOCO_GL names a missing or
unknown backend. A simulation draws nothing, so MuJoCo is then imported without OpenGL. Drawing
raises an error that says what to install: see `circle2d_mj.render.gl`.
"""

from __future__ import annotations

import os

VARIABLE = "MUJOCO_GL"

try:
    import mujoco
except Exception:  # a missing or broken backend may raise anything
    _named = os.environ.get(VARIABLE)
    os.environ[VARIABLE] = "disable"
    try:
        import mujoco
    finally:
        if _named is None:
            del os.environ[VARIABLE]
        else:
            os.environ[VARIABLE] = _named
from mujoco.batch import Batch  # noqa: E402

__all__ = ["Batch", "mujoco"]
