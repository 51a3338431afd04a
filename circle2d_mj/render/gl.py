"""MuJoCo's pictures, drawn off-screen with EGL or OSMesa, and its window.

MuJoCo chooses a backend on import, which fails if the backend that MUJOCO_GL names is missing. Here
the backend is chosen when the first picture is drawn.
"""

# mujoco has no stubs for its enums.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import atexit
import contextlib
import ctypes
import importlib
import os
import platform
import sys
import threading
import time
import weakref
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from circle2d_mj.core.envs import render_modes

VARIABLE = "MUJOCO_GL"
LIBRARIES = {"egl": "libEGL.so.1", "osmesa": "libOSMesa.so.8"}
"""Library of each backend, in the order in which the backends are tried."""
# Other values of MUJOCO_GL that MuJoCo accepts.
_OFF = ("disable", "disabled", "off", "false", "0")
_ON = ("", "enable", "enabled", "on", "true", "1", "glfw", "glx", "wgl", "cgl")
# MuJoCo sets this variable to the backend; PyOpenGL reads it only on its first import.
_BOUND = "PYOPENGL_PLATFORM"
HOW = (
    "drawing without a screen needs EGL (Debian, Ubuntu: apt-get install libegl1 libopengl0) or "
    f"OSMesa (apt-get install libosmesa6); {VARIABLE}=egl or {VARIABLE}=osmesa chooses one; if "
    "the variable is unset, the first that works is used"
)


class NoOpenGL(RuntimeError):
    """Pictures cannot be drawn off-screen; the message says what to install and what to set."""


def check_backend() -> None:
    """Raise NoOpenGL if MUJOCO_GL names a missing or unknown backend, or disables OpenGL."""
    named = os.environ.get(VARIABLE, "").lower().strip()
    if named in LIBRARIES:
        _load(named)
    elif named == "glfw" and "human" not in render_modes():
        raise NoOpenGL(f"{VARIABLE}=glfw needs a screen; {HOW}")
    elif named in _OFF:
        raise NoOpenGL(f"{VARIABLE}={named} disables drawing; {HOW}")
    elif named not in _ON:
        raise NoOpenGL(f"{VARIABLE}={named!r} is no backend that MuJoCo knows; {HOW}")


FREE_CAMERA = -1
"""Id of MuJoCo's free camera, which looks at the centre of the model."""


class Offscreen:
    """An off-screen buffer that a model is drawn into.

    width, height: size of the pictures in pixels; forces: draw contact forces as arrows. Raises
    NoOpenGL, and RuntimeError once closed.
    """

    def __init__(self, model: Any, width: int, height: int, forces: bool = False) -> None:
        check_backend()
        from circle2d_mj.core.engine import mujoco

        context = _gl_context(width, height)
        self._mujoco, self._model, self._context = mujoco, model, context
        try:
            with _current(context), _of_size(model, width, height):
                self._mjr = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
                mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._mjr)
        except mujoco.FatalError as error:  # GLFW without a screen fails only here
            raise NoOpenGL(f"{HOW}. MuJoCo says: {error}") from None
        self._mjr.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR  # the more precise mapping
        self._scene = mujoco.MjvScene(model, maxgeom=model.ngeom + 100)  # 100 for force arrows
        self._camera, self._option = mujoco.MjvCamera(), mujoco.MjvOption()
        self._option.flags[mujoco.mjtVisFlag.mjVIS_CONTACTFORCE] = forces
        self._rectangle = mujoco.MjrRect(0, 0, width, height)
        self._picture = np.empty((height, width, 3), dtype=np.uint8)
        self._free = weakref.finalize(self, _free, context, self._mjr)
        # Free the buffer at exit too, but before MuJoCo releases EGL, for which it has registered
        # by now. weakref would be too late: all its finalizers run at the place in atexit's order
        # where the first was made, perhaps by another package long before.
        self._free.atexit = False
        atexit.register(self._free)

    def draw(self, data: Any, camera: int) -> NDArray[np.uint8]:
        """Draw the view of a camera, `FREE_CAMERA` or a camera of the model: [height, width, 3],
        the top row first."""
        self._render(data, camera)
        with _current(self._context):
            self._mujoco.mjr_readPixels(self._picture, None, self._rectangle, self._mjr)
        return self._picture[::-1].copy()

    def depth(self, data: Any, camera: int) -> NDArray[np.float32]:
        """Return the depth of each pixel along the camera's axis, m: [height, width]. It is the far
        clipping distance where the camera sees nothing nearer."""
        flags = self._scene.flags
        # As in mujoco.Renderer: without blending, depths are far more precise.
        plain = self._mujoco.mjtRndFlag.mjRND_SEGMENT, self._mujoco.mjtRndFlag.mjRND_IDCOLOR
        for flag in plain:
            flags[flag] = True
        self._render(data, camera)
        for flag in plain:
            flags[flag] = False
        buffer = np.empty(self._picture.shape[:2], dtype=np.float32)
        with _current(self._context):
            self._mujoco.mjr_readPixels(None, buffer, self._rectangle, self._mjr)
        # share is 1 at the near plane and 0 at the far plane. In between, the inverse of the
        # distance is linear in it; for an orthographic camera the distance itself is.
        seen, share = self._scene.camera[0], buffer[::-1].astype(np.float64)
        near, far = float(seen.frustum_near), float(seen.frustum_far)
        if seen.orthographic:
            return (far - share * (far - near)).astype(np.float32)
        return (1.0 / (1.0 / far + share * (1.0 / near - 1.0 / far))).astype(np.float32)

    def _render(self, data: Any, camera: int) -> None:
        self._check_open()
        mujoco, everything = self._mujoco, self._mujoco.mjtCatBit.mjCAT_ALL
        if camera == FREE_CAMERA:
            mujoco.mjv_defaultFreeCamera(self._model, self._camera)
        else:
            self._camera.type, self._camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, camera
        mujoco.mjv_updateScene(
            self._model, data, self._option, None, self._camera, everything, self._scene
        )
        with _current(self._context):
            mujoco.mjr_render(self._rectangle, self._scene, self._mjr)

    def close(self) -> None:
        """Free the OpenGL context and its memory."""
        self._free()
        atexit.unregister(self._free)

    def _check_open(self) -> None:
        if not self._free.alive:
            raise RuntimeError("the renderer is closed")


@contextlib.contextmanager
def _of_size(model: Any, width: int, height: int) -> Iterator[None]:
    """Set the buffer size that a context gets from the model, and reduce the facets of round bodies
    to what this size can show: in small pictures they would take most of the time."""
    buffer, quality = model.vis.global_, model.vis.quality
    before = buffer.offwidth, buffer.offheight, quality.numslices, quality.numstacks
    slices = max(max(width, height) // 10, 16)
    buffer.offwidth, buffer.offheight = width, height
    quality.numslices = min(quality.numslices, slices)
    quality.numstacks = min(quality.numstacks, max(slices // 2, 8))
    try:
        yield
    finally:
        buffer.offwidth, buffer.offheight, quality.numslices, quality.numstacks = before


@contextlib.contextmanager
def _current(context: Any) -> Iterator[None]:
    """Make the context current, and afterwards the previous one if MuJoCo supports it (4.0)."""
    if hasattr(context, "as_current"):
        with context.as_current():
            yield
    else:
        context.make_current()
        yield


def _free(context: Any, mjr: Any) -> None:
    with _current(context):
        mjr.free()
    context.free()


def _load(backend: str) -> None:
    try:
        ctypes.CDLL(LIBRARIES[backend])
    except OSError:
        raise NoOpenGL(f"{LIBRARIES[backend]} is missing: {HOW}") from None


def _gl_context(width: int, height: int) -> Any:
    """Return a context of the backend that MUJOCO_GL names, else of the first one that works."""
    named = os.environ.get(VARIABLE, "").lower().strip()
    if platform.system() != "Linux" or named == "glfw":
        import mujoco

        return mujoco.GLContext(width, height)  # MuJoCo's own choice
    failures = []
    for backend in [named] if named in LIBRARIES else LIBRARIES:
        modules, bound = set(sys.modules), os.environ.get(_BOUND)
        try:
            _load(backend)
            context = importlib.import_module(f"mujoco.{backend}").GLContext(width, height)
        except NoOpenGL:
            failures.append(f"{backend}: {LIBRARIES[backend]} is missing")
        except Exception as error:  # a driver may raise anything
            failures.append(f"{backend}: {error}")
            _unbind(modules, bound)
        else:
            if failures:  # MuJoCo would again try EGL first when it looks up OpenGL's functions
                os.environ[VARIABLE] = backend
            return context
    raise NoOpenGL(f"{HOW}. Tried {'; '.join(failures)}")


def _unbind(modules: set[str], bound: str | None) -> None:
    """Unload OpenGL modules that are not in `modules`: they are bound to the failed backend."""
    for name in set(sys.modules) - modules:
        if name.startswith(("OpenGL", "mujoco.egl", "mujoco.osmesa")):
            del sys.modules[name]
    if bound is None:
        os.environ.pop(_BOUND, None)


class Window:
    """A window that shows states of a model in real time; the constructor opens it.

    step_time: seconds per environment step.
    """

    def __init__(self, model: Any, step_time: float) -> None:
        import mujoco.viewer

        self._model, self._step_time = model, step_time
        self._data = mujoco.MjData(model)
        before = set(threading.enumerate())
        self._viewer = mujoco.viewer.launch_passive(model, self._data)
        self._threads = set(threading.enumerate()) - before
        self._shown = time.monotonic()

    def show(self, data: Any) -> None:
        """Show a state with its derived quantities; return when the step's time is over."""
        import mujoco

        with self._viewer.lock():
            mujoco.mj_copyData(self._data, self._model, data)
        self._viewer.sync()
        time.sleep(max(self._shown + self._step_time - time.monotonic(), 0.0))
        self._shown = time.monotonic()

    def close(self) -> None:
        """Close the window."""
        self._viewer.close()
        for thread in self._threads:
            thread.join(timeout=5.0)  # if the program ended before the thread, it would crash
