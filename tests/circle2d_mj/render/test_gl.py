"""Drawing without a screen, each time in a fresh process: a process chooses its OpenGL once."""

import ctypes
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import circle2d_mj
from circle2d_mj.render.gl import LIBRARIES, VARIABLE

# Arguments: "mujoco-first" imports mujoco first, "mujoco-3.17" removes what that version lacks.
DRAW = """
import sys, weakref
class Other: ...
other = Other()
weakref.finalize(other, int)  # its exit hook runs after everything that is registered from here on
if "mujoco-first" in sys.argv:
    import mujoco
from circle2d_mj.render.gl import NoOpenGL, Offscreen, check_backend
if "mujoco-3.17" in sys.argv:
    import importlib, os
    del importlib.import_module("mujoco." + os.environ["MUJOCO_GL"]).GLContext.as_current
XML = (
    "<mujoco><worldbody><camera name='top' pos='0 0 2' projection='orthographic' fovy='2'/>"
    "<light pos='0 0 3'/><geom size='.1' pos='.5 .5 0' rgba='1 0 0 1'/></worldbody></mujoco>")
try:
    check_backend()  # before mujoco is imported, unless it is first
    from circle2d_mj.core.engine import mujoco
    model = mujoco.MjModel.from_xml_string(XML)
    offscreen = Offscreen(model, 61, 62)  # OpenGL aligns rows of pixels to 4 bytes by default
except NoOpenGL as error:
    print("NoOpenGL", error)
    raise SystemExit
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
picture = offscreen.draw(data, 0)
assert picture.shape == (62, 61, 3), picture.shape
rows, columns = (picture[..., 0] > 100).nonzero()
assert abs(columns.mean() + 0.5 - 46) < 1 and abs(rows.mean() + 0.5 - 15.5) < 1, (columns, rows)
print(type(offscreen._context).__module__)
"""  # it ends without closing the buffer

# Buffers of the package and renderers of MuJoCo draw in turns; then many of the package's.
TURNS = """
import gc, os
from pathlib import Path
import mujoco
from circle2d_mj.render.gl import FREE_CAMERA, Offscreen

model = mujoco.MjModel.from_xml_string(
    "<mujoco><visual><quality shadowsize='0'/></visual><worldbody><light pos='0 0 3'/>"
    "<geom size='1' rgba='1 0 0 1'/></worldbody></mujoco>")
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)

def theirs(renderer):
    renderer.update_scene(data)
    return renderer.render()

def ours(offscreen):
    return offscreen.draw(data, FREE_CAMERA)

first, one = Offscreen(model, 64, 64), mujoco.Renderer(model, 50, 50)
second, other = Offscreen(model, 100, 33), mujoco.Renderer(model, 40, 40)
pictures = ours(first), theirs(one).copy(), ours(second), theirs(other).copy()
assert len({p.tobytes() for p in pictures}) == 4 and all(p.std() > 10 for p in pictures)
for _ in range(2):
    assert (theirs(other) == pictures[3]).all() and (ours(first) == pictures[0]).all()
    assert (ours(second) == pictures[2]).all() and (theirs(one) == pictures[1]).all()
second.close(), one.close()
assert (ours(first) == pictures[0]).all() and (theirs(other) == pictures[3]).all()
first.close()
assert (theirs(other) == pictures[3]).all()

def held():
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return len(os.listdir("/proc/self/fd")), pages * os.sysconf("SC_PAGE_SIZE") / 2**20

def draw(times):
    for k in range(times):
        offscreen = Offscreen(model, 32, 32)
        ours(offscreen)
        if k % 2:
            offscreen.close()  # the others go when they are no longer referred to

draw(2)
files, megabytes = held()
draw(6)
more_files, more_megabytes = held()
assert more_files == files and more_megabytes < megabytes + 20, (megabytes, more_megabytes)
"""

HUMAN = """
import numpy as np
from circle2d_mj import Circle2DEnv
env = Circle2DEnv(level=1, render_mode="human")
env.reset(seed=0)
env.step(np.zeros(2))
assert env.render() is None
env.close()
env.close()
"""


def exists(backend):
    try:
        ctypes.CDLL(LIBRARIES[backend])
    except OSError:
        return False
    return True


def needs(*backends):
    missing = [LIBRARIES[b] for b in backends if not exists(b)]
    return pytest.mark.skipif(bool(missing), reason=f"no {', '.join(missing)} on this machine")


ANY = next((backend for backend in LIBRARIES if exists(backend)), None)
needs_any = pytest.mark.skipif(ANY is None, reason="neither EGL nor OSMesa on this machine")
EACH = [pytest.param(backend, marks=needs(backend)) for backend in LIBRARIES]


@pytest.fixture
def python(tmp_path):
    """Return a function that runs code in a fresh Python without a screen and returns its output.

    hide: libraries to hide from that process. Files with their names that are no libraries come
    first on the path, which works for ctypes, PyOpenGL and MuJoCo alike.
    """

    def run(code, *arguments, hide=(), under=(), **variables):
        for library in hide:
            (tmp_path / library).touch()
        unset = {"DISPLAY", "WAYLAND_DISPLAY", VARIABLE, "PYOPENGL_PLATFORM"}
        environment = {k: v for k, v in os.environ.items() if k not in unset}
        path = environment.get("LD_LIBRARY_PATH", "")
        environment["LD_LIBRARY_PATH"] = f"{tmp_path}:{path}" if path else str(tmp_path)
        environment["PYTHONPATH"] = str(Path(circle2d_mj.__file__).parents[1])
        done = subprocess.run(
            [*under, sys.executable, "-W", "error", "-c", code, *arguments],
            env=environment | variables,
            capture_output=True,
            text=True,
            timeout=60,
        )
        assert done.returncode == 0, done.stderr
        assert done.stderr == ""  # such as "Exception ignored" at the end
        return done.stdout.strip()

    return run


# mujoco 3.17, the lowest allowed version and the last for Python 3.10, has no `as_current`.
NAMED = [
    pytest.param(backend, first, marks=needs(backend))
    for backend in LIBRARIES
    for first in ("", "mujoco-3.17")
]
UNSET = [pytest.param("", first, marks=needs_any) for first in ("", "mujoco-first")]


@pytest.mark.parametrize(("backend", "first"), NAMED + UNSET)
def test_the_named_backend_or_else_the_first_that_is_installed(python, backend, first):
    named = {"MUJOCO_GL": backend} if backend else {}
    assert python(DRAW, first, **named) == f"mujoco.{backend or ANY}"


@needs("osmesa")
def test_without_egl_osmesa_is_taken(python):
    assert python(DRAW, hide=[LIBRARIES["egl"]]) == "mujoco.osmesa"


@needs("egl", "osmesa")
def test_if_egl_fails_osmesa_is_taken(python):
    """A container may have EGL's library but no device; here the named device does not exist."""
    assert python(DRAW, "mujoco-first", MUJOCO_EGL_DEVICE_ID="99") == "mujoco.osmesa"


def says_what_to_do(message):
    return all(word in message for word in ("libegl1", "libosmesa6", "MUJOCO_GL=egl", "NoOpenGL"))


@pytest.mark.parametrize(("first", "named"), [("mujoco-first", None), ("", "egl")])
def test_without_a_library_the_error_says_what_to_install(python, first, named):
    variables = {VARIABLE: named} if named else {}
    message = python(DRAW, first, hide=LIBRARIES.values(), **variables)
    assert says_what_to_do(message)
    for backend, library in LIBRARIES.items():
        assert (f"{library} is missing" in message) == (named in (None, backend))


@needs("egl")
def test_a_named_egl_that_fails_is_not_replaced(python):
    message = python(DRAW, MUJOCO_GL="egl", MUJOCO_EGL_DEVICE_ID="99")
    assert says_what_to_do(message)
    tried = message.partition("Tried egl: ")[2]
    assert "got 99" in tried
    assert "osmesa: " not in tried


def test_glfw_without_a_screen_says_what_to_do(python):
    quiet = {"PYTHONWARNINGS": "ignore", "PYGLFW_LIBRARY_VARIANT": "x11"}
    code = f"import warnings; warnings.simplefilter('ignore')\n{DRAW}"
    assert says_what_to_do(python(code, MUJOCO_GL="glfw", **quiet))


@pytest.mark.parametrize("backend", EACH)
def test_mujocos_own_renderer_in_turns_and_many_renderers(python, backend):
    python(TURNS, MUJOCO_GL=backend)


@pytest.mark.parametrize("task", ["Circle2D-1-v0", "Circle2DMuJoCo-1-v0", "SafetyPointGoal1-v0"])
def test_human_mode_needs_a_screen(task, python):
    """And gymnasium does not replace it by a wrapper that needs pygame."""
    make = f"gymnasium.make('{task}', render_mode='human')"
    code = f"import gymnasium, circle2d_mj\ntry:\n    {make}\n"
    message = python(f"{code}except ValueError as error:\n    print(error)")
    assert "'human' needs a screen" in message
    assert "rgb_array" in message


@pytest.mark.skipif(shutil.which("xvfb-run") is None, reason="no xvfb-run on this machine")
def test_human_mode_on_a_virtual_screen(python):
    python(HUMAN, under=["xvfb-run", "-a"])


FRAMES = """
import sys
import numpy as np
from circle2d_mj.circle2d.mujoco_envs import Circle2DMuJoCoVectorEnv
frames = []
rigid, soft = {"level": 0}, {"level": 1, "contact": "soft"}
for camera, parameters in (("top", soft), ("side", rigid), ("follow", rigid), ("follow", soft)):
    how = {"render_mode": "rgb_array", "camera": camera, "autoreset_mode": "Disabled"}
    envs = Circle2DMuJoCoVectorEnv(1, **how, **parameters)
    envs.reset(seed=0)
    envs.simulation.dynamics.place(np.array([0]), np.array([[10.6, 0.0]]))
    frames.append(envs.render()[0])
    for _ in range(3):
        force = envs.step(np.array([[-1.0, 0.0]]))[-1]["contact_force"]
    assert force > 0
    frames.append(envs.render()[0])
    envs.close()
np.save(sys.argv[1], frames)
"""


@pytest.fixture
def mujocos_frames(python, tmp_path):
    """Return a function: backend -> frames [4, 2, 640, 640, 3] of four scenes of `FRAMES`, before
    and in contact."""

    def draw(backend):
        python(FRAMES, str(tmp_path / f"{backend}.npy"), MUJOCO_GL=backend)
        return np.load(tmp_path / f"{backend}.npy").reshape(4, 2, 640, 640, 3).astype(int)

    return draw


@pytest.mark.slow
@pytest.mark.parametrize("backend", EACH)
def test_mujocos_frames_show_ball_shadow_and_force(mujocos_frames, backend):
    for frames in mujocos_frames(backend):
        red, green, blue = np.moveaxis(frames, -1, 0)
        ball = (red > 2 * green) & (blue > green)
        arrow = (red > 1.5 * green) & (green > 1.5 * blue)
        grey = np.ptp(frames, axis=-1) < 3  # floor, region and shadow
        assert ball[0].any()
        assert not arrow[0].any()
        assert arrow[1].any()
        assert len(np.unique(red[0][grey[0]])) >= 3


@pytest.mark.slow
@needs("egl", "osmesa")
def test_egl_and_osmesa_draw_the_same(mujocos_frames):
    """Except at edges of shapes and shadows."""
    off = np.abs(mujocos_frames("egl") - mujocos_frames("osmesa")).max(axis=-1)
    assert (off > 8).mean() < 0.01
    assert off.mean() < 1.0
