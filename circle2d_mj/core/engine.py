"""MuJoCo, imported for simulation.

MuJoCo chooses its OpenGL backend on import, and the import fails if MUJOCO_GL names a missing or
unknown backend. A simulation draws nothing, so MuJoCo is then imported without OpenGL. Drawing
raises an error that says what to install: see `circle2d_mj.render.gl`.

MuJoCo's profiler is switched off, since reading its clock takes 5 to 20 % of a simulation's time:
the durations in `mjData.timer` stay 0. `mujoco.set_mjcb_time(None)` switches it on again, and a
clock that was set before this module is imported stays.
"""

# pyright: reportAttributeAccessIssue=false
# mujoco's names are defined in compiled modules, which pyright cannot read.

from __future__ import annotations

import ctypes
import os
from contextlib import suppress

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
from mujoco import _callbacks  # noqa: E402
from mujoco.batch import Batch  # noqa: E402

if mujoco.get_mjcb_time() is None:
    # No function of `mujoco` removes its clock: None sets it again. Where its library does not
    # export the pointer, the clock stays, which only takes time.
    with suppress(ValueError):
        ctypes.c_void_p.in_dll(ctypes.CDLL(_callbacks.__file__), "mjcb_time").value = None

__all__ = ["Batch", "mujoco"]
