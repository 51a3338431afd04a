"""MuJoCo, imported for simulation.

MuJoCo chooses its OpenGL backend when it is imported, and fails there where MUJOCO_GL names one
that is missing or unknown. A simulation draws nothing: then it is imported without OpenGL. Whoever
draws gets the error that says what to install: see `circle2d_mj.render.gl`.
"""

from __future__ import annotations

import os

VARIABLE = "MUJOCO_GL"

try:
    import mujoco
except Exception:  # whatever a missing or broken backend raises
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
